"""Damping trades the task's error for joint rate, and bounds the rate by ‖ẋ‖_B/2λ."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_robots import (
    asked,
    definite,
    each_robot,
    examples,
    numbers,
    planar_arm,
    random_moment,
    random_robot,
    unit_links,
)

# Rounding of the largest of the values compared, times the condition of 1e6 at the least λ.
ROUNDING = 1e-9
DAMPINGS = np.geomspace(0.01, 10.0, 10).tolist()

WAYS = {
    "dls": {"method": "dls"},
    "qp": {},
    "limits": {"limits": {"position": "off", "velocity": {"default": 0.3}}},
}

each_way = pytest.mark.parametrize("way", WAYS)


@each_robot
@each_way
@examples(3)
@given(numbers)
def test_damping_trades_error_for_rate(robot, way, tmp_path_factory, number) -> None:
    # As in any convex program: a larger weight on ‖v‖² cannot raise it, nor lower the other term.
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    weight = definite(rng, len(arm.rows))
    moment, rates, errors = None, [], []
    for damping in DAMPINGS:
        options = {"damping": {"lambda": damping}, **WAYS[way]}
        controller = arm.controller(arm.hand(weight), **options)
        moment = moment or random_moment(controller, rng)
        v = moment.step(controller).v
        jacobian, rate = asked(controller)
        missed = rate - jacobian @ v
        rates.append(np.linalg.norm(v))
        errors.append(np.sqrt(missed @ weight @ missed))
    assert (np.diff(rates) <= ROUNDING * rates[0]).all()
    assert (np.diff(errors) >= -ROUNDING * errors[-1]).all()
    assert rates[-1] < rates[0]
    assert errors[-1] > errors[0]


@each_robot
@each_way
@examples(10)
@given(numbers, st.sampled_from([1e-3, 1e-2, 1e-1, 1.0]), st.booleans())
def test_the_rate_is_bounded(robot, way, tmp_path_factory, number, damping, straight) -> None:
    # With limits, too: v = 0 is inside, so that λ²‖v‖² ≤ ⟨ẋ, Jv⟩_B − ‖Jv‖²_B ≤ ¼‖ẋ‖²_B.
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    weights = {"hand": definite(rng, len(arm.rows)), "com": definite(rng, 3)}
    com = {"name": "com", "type": "com", "B": weights["com"].tolist()}
    options = {"damping": {"lambda": damping}, **WAYS[way]}
    controller = arm.controller(arm.hand(weights["hand"]), com, **options)
    moment = random_moment(controller, rng)
    if straight and robot == "planar":
        moment.q[1:] = 1e-6  # next to its singularity
    v = moment.step(controller).v
    squared = 0.0
    for name, rate in (("hand", asked(controller)[1]), ("com", asked(controller, "com")[1])):
        squared += rate @ weights[name] @ rate
    assert np.linalg.norm(v) <= np.sqrt(squared) / (2.0 * damping) * (1.0 + ROUNDING)


@pytest.mark.parametrize("way", ["dls", "qp"])
@examples(10)
@given(numbers, st.integers(0, 1))
def test_the_bound_is_attained(way, tmp_path_factory, number, direction) -> None:
    # Where λ is the singular value of the direction that is asked for.
    rng = np.random.default_rng(number)
    arm = planar_arm(rng.uniform(0.3, 1.2, 4), tmp_path_factory.getbasetemp()).asking(0, 1)
    task, start = arm.hand(axes="world"), rng.uniform(0.2, 1.2, 4).tolist()
    bare = arm.controller(task, start=start)
    bare.step()
    left, sigma, _ = np.linalg.svd(asked(bare)[0])
    options = {"damping": {"lambda": sigma[direction]}, "start": start, **WAYS[way]}
    controller = arm.controller(task, **options)
    hand = controller.problem.term["hand"].target[4:]
    controller.set_target("hand", hand, velocity=[*left[:, direction], 0, 0, 0, 0])
    rate = np.linalg.norm(controller.step().v)
    assert rate == pytest.approx(1.0 / (2.0 * sigma[direction]), rel=ROUNDING)


@pytest.mark.parametrize("way", ["dls", "qp"])
def test_across_a_straight_arm_more_damping_is_less_rate_and_more_error(way) -> None:
    # Across unit links along x, σ² = 14: of 1 m/s, λ²/(14 + λ²) is missed.
    arm, missed = unit_links(3), []
    for damping in (0.01, 0.1, 1.0, 10.0):
        options = {"start": [0.0, 0.0, 0.0], "damping": {"lambda": damping}, **WAYS[way]}
        controller = arm.controller(arm.hand(axes="world"), **options)
        controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 1, 0, 0, 0, 0])
        missed.append(1.0 - [3.0, 2.0, 1.0] @ controller.step().v)
    assert missed == pytest.approx([7.14e-6, 7.14e-4, 6.67e-2, 0.877], rel=1e-3)
