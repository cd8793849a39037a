"""Saturation in the null space ends at its box QP, found independently by LPs and by DAQP."""

import daqp
import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from rmrc import reference

# The LP's feasibility tolerance, HiGHS' tightest, is 1e-10; it is multiplied by condition numbers.
LINEAR_PROGRAM = 1e-7
# DAQP's is 1e-10, multiplied in the same way.
QUADRATIC_PROGRAM = 1e-6
# Where there is a formula: rounding, times condition numbers up to 1e4.
EXACT = 1e-9

SHAPES = [(1, 1), (2, 2), (2, 3), (3, 7), (6, 6), (6, 7), (3, 30)]
EQUALITY = 5  # DAQP: active and immutable


def box_task(
    shape: tuple[int, int], number: int, reach: float, around: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return J, ẋ, lower and upper; the box surrounds `around` times a v that holds the task."""
    rng = np.random.default_rng(number)
    J, v = rng.normal(size=shape), rng.normal(size=shape[1])
    lower, upper = -rng.uniform(0.1, 1.0, shape[1]), rng.uniform(0.1, 1.0, shape[1])
    return J, reach * (J @ v), around * v + lower, around * v + upper


def linear_program(cost, **constraints) -> np.ndarray | None:
    """Return the minimum of a linear program, None if it is infeasible."""
    tolerances = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    result = linprog(cost, method="highs-ds", options=tolerances, **constraints)
    assert result.status in (0, 2)  # solved, infeasible
    return result.x if result.status == 0 else None


def largest_share(J, xdot, lower, upper) -> float | None:
    """Return the largest s ≤ 1 with Jv = sẋ inside the box; None if there is none."""
    x = linear_program(
        np.append(np.zeros(J.shape[1]), -1.0),
        A_eq=np.column_stack((J, -xdot)),
        b_eq=np.zeros(len(J)),
        bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
    )
    return None if x is None else float(x[-1])


def optimality_gap(J, v, lower, upper) -> float:
    """Return how far v is from having multipliers y of the task with v = Jᵀy + μ.

    The multipliers of the limits are μ ≥ 0 at a lower limit, μ ≤ 0 at an upper, 0 between.
    """
    above, below = v > lower, v < upper  # there μ ≤ 0, and μ ≥ 0
    rows = np.vstack((-J.T[above], J.T[below]))
    x = linear_program(
        np.append(np.zeros(len(J)), 1.0),
        A_ub=np.column_stack((rows, -np.ones(len(rows)))),
        b_ub=np.append(-v[above], v[below]),
        bounds=[(None, None)] * len(J) + [(0.0, None)],
    )
    assert x is not None
    return float(x[-1])


def box_qp(H, f, lower, upper, C=None, d=None) -> np.ndarray:
    """Return the minimum of ½vᵀHv + fᵀv inside the box, with Cv = d, by DAQP."""
    rows = np.zeros((0, len(f))) if C is None else C
    right = np.zeros(0) if d is None else d
    sense = np.zeros(len(f) + len(rows), dtype=np.int32)
    sense[len(f) :] = EQUALITY
    v, _, flag, _ = daqp.solve(
        H, f, rows, np.append(upper, right), np.append(lower, right), sense, primal_tol=1e-10
    )
    assert flag == 1
    return v


def share(J, xdot, v) -> float:
    return float(xdot @ J @ v / (xdot @ xdot))


def assert_optimal(J, xdot, lower, upper, v) -> None:
    """Hold v to the box, to the direction of ẋ, and to the least norm of all such."""
    assert (lower <= v).all()
    assert (v <= upper).all()
    assert abs(J @ v - share(J, xdot, v) * xdot).max() <= EXACT * max(1.0, abs(xdot).max())
    assert optimality_gap(J, v, lower, upper) <= LINEAR_PROGRAM


@seed(0)
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.floats(0.05, 5.0))
def test_saturated_is_the_box_qp(shape, number, reach) -> None:
    J, xdot, lower, upper = box_task(shape, number, reach)
    v = reference.saturated(J, xdot, lower, upper)
    s = share(J, xdot, v)
    assert_optimal(J, xdot, lower, upper, v)
    assert s == pytest.approx(largest_share(J, xdot, lower, upper), abs=LINEAR_PROGRAM)
    # At the largest s the box may leave a single point, which is nothing for a QP solver to find.
    slowed = xdot if s > 1.0 - EXACT else 0.999 * s * xdot
    expected = box_qp(np.eye(v.size), np.zeros(v.size), lower, upper, J, slowed)
    assert abs(reference.saturated(J, slowed, lower, upper) - expected).max() <= QUADRATIC_PROGRAM


@seed(0)
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.floats(0.2, 2.0), st.floats(-1.5, 1.5))
def test_limits_that_exclude_rest_are_met_or_refused(shape, number, reach, around) -> None:
    # As under acceleration limits: the box surrounds the present velocity, not zero.
    J, xdot, lower, upper = box_task(shape, number, reach, around)
    largest = largest_share(J, xdot, lower, upper)
    if largest is None:
        with pytest.raises(ValueError, match="no v inside them"):
            reference.saturated(J, xdot, lower, upper)
        return
    v = reference.saturated(J, xdot, lower, upper)
    assert_optimal(J, xdot, lower, upper, v)
    assert share(J, xdot, v) == pytest.approx(largest, abs=LINEAR_PROGRAM)


@seed(0)
@settings(max_examples=200, deadline=None)
@given(st.sampled_from([(1, 3), (2, 3), (2, 4), (3, 7)]), st.integers(0, 2**31))
def test_ties_and_lost_rank_are_settled(shape, number) -> None:
    # Small integers: joints reach their limits together, rows and columns repeat or vanish.
    rng = np.random.default_rng(number)
    J = rng.integers(-2, 3, shape).astype(float)
    xdot = J @ rng.integers(-3, 4, shape[1])
    upper = rng.integers(0, 3, shape[1]).astype(float)
    v = reference.saturated(J, xdot, -upper, upper)
    if xdot.any():
        assert_optimal(J, xdot, -upper, upper, v)
        largest = largest_share(J, xdot, -upper, upper)
        assert share(J, xdot, v) == pytest.approx(largest, abs=LINEAR_PROGRAM)
    else:
        assert not v.any()


@seed(0)
@settings(max_examples=100, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.floats(0.05, 5.0))
def test_inside_wide_limits_it_is_the_pseudo_inverse(shape, number, reach) -> None:
    J, xdot, _, _ = box_task(shape, number, reach)
    v = reference.pinv(J, xdot)
    np.testing.assert_array_equal(reference.saturated(J, xdot, -abs(v), abs(v)), v)


def test_outside_the_range_the_projection_is_followed() -> None:
    # The stretched planar arm cannot move along x; along y it can, at the limit of joint 1.
    v = reference.saturated([[0.0, 0.0], [2.0, 1.0]], [5.0, 4.0], -1.0, 1.0)
    assert abs(v - [1.0, 1.0]).max() <= EXACT


def test_it_uses_the_null_space_before_it_slows_down() -> None:
    J, xdot = np.array([[1.0, 1.0, 1.0]]), np.array([3.0])
    upper = np.array([0.5, 1.5, 2.0])
    v = reference.saturated(J, xdot, -upper, upper)
    assert abs(v - [0.5, 1.25, 1.25]).max() <= EXACT
    scaled = reference.pinv(J, xdot) * 0.5  # what scaling alone leaves
    assert share(J, xdot, v) > share(J, xdot, scaled)


@seed(0)
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.floats(0.05, 5.0), st.floats(0.03, 2.0))
def test_bounded_dls_is_the_box_qp(shape, number, reach, damping) -> None:
    J, xdot, lower, upper = box_task(shape, number, reach, around=0.3)
    v = reference.bounded_dls(J, xdot, lower, upper, damping)
    assert (lower <= v).all()
    assert (v <= upper).all()
    expected = box_qp(J.T @ J + damping**2 * np.eye(shape[1]), -J.T @ xdot, lower, upper)
    assert abs(v - expected).max() <= QUADRATIC_PROGRAM
    free = reference.dls(J, xdot, damping)
    assert abs(reference.bounded_dls(J, xdot, -np.inf, np.inf, damping) - free).max() <= EXACT


@seed(0)
@settings(max_examples=100, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.sampled_from([1e-2, 1e-4, 1e-6]))
def test_bounded_dls_is_optimal_at_small_damping(shape, number, damping) -> None:
    J, xdot, lower, upper = box_task(shape, number, 3.0)
    v = reference.bounded_dls(J, xdot, lower, upper, damping)
    gradient = J.T @ (J @ v - xdot) + damping**2 * v
    gradient[(v == lower) & (gradient > 0.0)] = 0.0
    gradient[(v == upper) & (gradient < 0.0)] = 0.0
    assert abs(gradient).max() <= EXACT * max(1.0, abs(J.T @ xdot).max())


@seed(0)
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(SHAPES), st.integers(0, 2**31), st.floats(0.05, 5.0))
def test_the_multipliers_are_those_of_the_limits_in_the_way(shape, number, reach) -> None:
    J, xdot, lower, upper = box_task(shape, number, reach)
    v, scale, z = reference.saturate(J, xdot, lower, upper)
    assert scale == pytest.approx(share(J, xdot, v), abs=EXACT)
    np.testing.assert_allclose(v[z > 0.0], upper[z > 0.0], rtol=EXACT)
    np.testing.assert_allclose(v[z < 0.0], lower[z < 0.0], rtol=EXACT)
    if scale == 1.0:  # v + Jᵀλ + z = 0 for some λ
        rest = v + z
        rest -= np.linalg.pinv(J) @ (J @ rest)
        assert abs(rest).max() <= EXACT * max(1.0, abs(z).max())
    else:
        assert z.any()


def test_where_the_task_is_slowed_the_multiplier_says_what_a_limit_is_worth() -> None:
    # J = diag(2, 1) and ẋ = (4, 1): joint 1 at its limit of 1 rad/s holds s at 1/2.
    v, scale, z = reference.saturate(np.diag([2.0, 1.0]), [4.0, 1.0], -1.0, [1.0, 3.0])
    assert scale == 0.5
    assert v.tolist() == [1.0, 0.5]
    assert z == pytest.approx([0.5, 0.0], abs=EXACT)  # s = limit/2
    assert not reference.saturate(np.eye(2), [1.0, -1.0], -1.0, 1.0).multiplier.any()


# ½‖v_N‖² weighs 1e-6 beside s, so that v changes by 1e6 of what a part of the null space does; a
# part of less than 1e-9 is none.
SLOPE, NONE = 2e6, 1e-9


@pytest.mark.parametrize("bound", [0.5, 0.05])
def test_a_part_of_the_null_space_that_gains_nothing_moves_nothing(bound: float) -> None:
    """v jumped by 0.09 rad/s and more where a joint's part in the null space passed 1e-9."""

    def at(part: float) -> reference.Saturation:
        return reference.saturate([[1.0, part, 0.0], [0.0, 0.0, 1.0]], [1.0, 0.1], -bound, bound)

    before = at(0.0)
    assert before.scale == pytest.approx(bound)
    assert abs(before.v[1]) < 1e-9
    last = 0.0
    for part in np.geomspace(1e-12, 1e-3, 400):
        now = at(float(part))
        assert np.abs(now.v - before.v).max() <= SLOPE * (part - last + NONE)
        assert now.scale >= before.scale - NONE
        before, last = now, part
    assert before.v[1] == pytest.approx(bound)  # where it gains more, as much as there is
