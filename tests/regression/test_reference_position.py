"""The planar arm in closed form, the methods iterated on it, and gradient descent."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from rmrc import reference
from rmrc.reference import planar_2r

# Positions of metres, through a handful of trigonometric functions.
EXACT = 1e-12
# Central differences of 1e-6 rad: rounding over the difference.
DIFFERENCE = 1e-9

angles = st.floats(-np.pi, np.pi)
lengths = st.tuples(st.floats(0.2, 2.0), st.floats(0.2, 2.0))


@seed(0)
@settings(max_examples=200, deadline=None)
@given(angles, angles, lengths)
def test_both_branches_reach_the_position_and_one_is_where_it_came_from(q1, q2, lengths) -> None:
    position = planar_2r.forward([q1, q2], lengths)
    if np.linalg.norm(position) < 1e-6:  # there q₁ is not determined
        return
    branches = planar_2r.inverse(position, lengths)
    for q in branches:
        assert abs(planar_2r.forward(q, lengths) - position).max() <= EXACT
    assert branches[0, 1] >= 0.0 >= branches[1, 1]
    # sin q₂ is where the position says the least: its square root of rounding is all there is.
    turns = np.exp(1j * branches) - np.exp(1j * np.array([q1, q2]))
    nearness = min(1.0, np.linalg.norm(position))
    assert abs(turns).max(axis=1).min() <= 1e-6 / nearness


@seed(0)
@settings(max_examples=100, deadline=None)
@given(angles, angles, lengths, angles)
def test_velocity_is_the_derivative_and_the_inverse(q1, q2, lengths, heading) -> None:
    q, xdot = np.array([q1, q2]), np.array([np.cos(heading), np.sin(heading)])
    J = planar_2r.jacobian(q, lengths)
    for column, change in zip(J.T, 1e-6 * np.eye(2), strict=True):
        ahead, behind = (
            planar_2r.forward(q + change, lengths),
            planar_2r.forward(q - change, lengths),
        )
        assert abs((ahead - behind) / 2e-6 - column).max() <= DIFFERENCE
    if abs(np.sin(q2)) > 1e-3:
        v = planar_2r.velocity(q, xdot, lengths)
        assert abs(v - reference.inverse(J, xdot)).max() <= DIFFERENCE * max(1.0, abs(v).max())


@pytest.mark.parametrize("reach", [1.0, 1.0 + 1e-15, 1.0 - 1e-15])
def test_the_ends_of_the_reach_are_reached(reach) -> None:
    outer, inner = 2.0 * reach * np.array([0.6, 0.8]), reach * np.array([0.6, 0.8])
    for position, links, folded in ((outer, (1.0, 1.0), 1.0), (inner, (1.5, 0.5), -1.0)):
        for q in planar_2r.inverse(position, links):
            assert abs(np.cos(q[1]) - folded) <= EXACT
            assert abs(planar_2r.forward(q, links) - position).max() <= EXACT


def test_out_of_reach_and_singular_say_so() -> None:
    with pytest.raises(ValueError, match=r"2\.1 m from the base, out of reach: .* to 2 m"):
        planar_2r.inverse([0.0, 2.1])
    with pytest.raises(ValueError, match=r"0\.3 m from the base, out of reach: .* from 0\.5 m"):
        planar_2r.inverse([0.3, 0.0], (1.0, 0.5))
    with pytest.raises(ValueError, match="position is the base, a singularity"):
        planar_2r.inverse([0.0, 0.0])
    for q2 in (0.0, np.pi):
        with pytest.raises(ValueError, match="q is singular: the arm is stretched or folded"):
            planar_2r.velocity([0.3, q2], [1.0, 0.0])


def iterate(
    step: Callable[[np.ndarray, np.ndarray], np.ndarray], q, target, limit: int
) -> tuple[list[float], list[float]]:
    """Return the errors, m, and the largest joint steps, rad, until the error is below 1e-9 m."""
    q, errors, steps = np.array(q, dtype=float), [], []
    for _ in range(limit):
        error = target - planar_2r.forward(q)
        errors.append(float(np.linalg.norm(error)))
        if errors[-1] < 1e-9:
            break
        change = step(planar_2r.jacobian(q), error)
        steps.append(float(abs(change).max()))
        q += change
    return errors, steps


def test_near_the_goal_the_transpose_takes_more_steps_than_the_inverse() -> None:
    target = planar_2r.forward([0.31, 1.22])
    by_inverse, _ = iterate(reference.inverse, [0.3, 1.2], target, 100)
    by_transpose, _ = iterate(reference.transpose, [0.3, 1.2], target, 100)
    assert len(by_inverse) == 1 + 3  # quadratic: the digits double at each step
    assert len(by_transpose) >= 1 + 3 * 3  # linear: 11 steps
    assert by_transpose[-1] < 1e-9


def test_at_the_singularity_the_inverse_blows_up_and_the_transpose_does_not() -> None:
    xdot = np.array([1.0, 0.0])
    for q2 in (1e-2, 1e-4, 1e-6):
        J = planar_2r.jacobian([0.0, q2])
        assert abs(reference.inverse(J, xdot)).max() >= 1.9 / q2  # 2/q₂ rad/s
        assert abs(reference.transpose(J, xdot)).max() <= q2
        assert abs(reference.dls(J, xdot, 0.1)).max() <= reference.step_bound(xdot, 0.1)


@pytest.mark.parametrize("q2", [1e-1, 1e-3, 1e-6])
@pytest.mark.parametrize("target", [[1.5, 0.0], [1.99, 0.0], [0.5, 1.0]])
def test_selective_damping_converges_from_near_the_singularity(q2, target) -> None:
    def step(J: np.ndarray, error: np.ndarray) -> np.ndarray:
        return reference.selectively_damped(J, reference.clamp(error, 0.5))

    errors, steps = iterate(step, [0.0, q2], np.array(target), 200)
    assert errors[-1] < 1e-9
    assert max(steps) <= np.pi / 4 + EXACT


def test_selective_damping_settles_on_a_target_out_of_reach() -> None:
    def step(J: np.ndarray, error: np.ndarray) -> np.ndarray:
        return reference.selectively_damped(J, reference.clamp(error, 0.5))

    errors, _ = iterate(step, [0.4, 1.0], np.array([2.5, 0.0]), 300)
    assert abs(errors[-1] - 0.5) <= 1e-4


@seed(0)
@settings(max_examples=40, deadline=None)
@given(angles, st.floats(0.2, 2.9), angles, st.floats(0.2, 2.9))
def test_descent_falls_at_every_step_and_arrives(q1, q2, start1, start2) -> None:
    target, errors = planar_2r.forward([q1, q2]), []

    def jacobian(q: np.ndarray) -> np.ndarray:
        errors.append(np.linalg.norm(target - planar_2r.forward(q)))
        return planar_2r.jacobian(q)

    result = reference.descent(
        target, [start1, start2], planar_2r.forward, jacobian, max_iterations=5000
    )
    errors.append(result.error)
    assert all(np.diff(errors) < 0.0)
    assert result.iterations == len(errors) - 1
    assert result.converged
    assert result.error <= 1e-6
    assert abs(np.linalg.norm(target - planar_2r.forward(result.q)) - result.error) <= EXACT


def test_descent_ends_where_no_step_helps() -> None:
    out_of_reach = reference.descent([2.5, 0.0], [0.3, 0.2], planar_2r.forward, planar_2r.jacobian)
    assert not out_of_reach.converged
    assert abs(out_of_reach.error - 0.5) <= 1e-6
    # Stretched and pulled inwards: Jᵀe = 0, a saddle.
    saddle = reference.descent([1.0, 0.0], [0.0, 0.0], planar_2r.forward, planar_2r.jacobian)
    assert (saddle.converged, saddle.iterations, saddle.error) == (False, 0, 1.0)
    short = reference.descent(
        [1.0, 1.0], [0.3, 0.2], planar_2r.forward, planar_2r.jacobian, max_iterations=2
    )
    assert (short.converged, short.iterations) == (False, 2)
    there = reference.descent([2.0, 0.0], [0.0, 0.0], planar_2r.forward, planar_2r.jacobian)
    assert (there.converged, there.iterations) == (True, 0)


@seed(0)
@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=7),
    st.one_of(st.floats(1e-3, 1e3), st.just(np.inf)),
)
def test_clamp_shortens_and_keeps_the_direction(values, limit) -> None:
    dx = np.array(values)
    clamped = reference.clamp(dx, limit)
    length = np.linalg.norm(dx)
    assert np.linalg.norm(clamped) <= min(limit, length) * (1.0 + EXACT)
    assert abs(clamped * max(1.0, length / limit) - dx).max() <= EXACT * max(1.0, length)
    assert clamped is not dx
