"""The metric A = JᵀBJ of a task gives the motion of that task that is least in ‖ẋ‖_B."""

import numpy as np
import pytest
from hypothesis import assume, given
from random_robots import (
    Robot,
    asked,
    assert_close,
    definite,
    examples,
    numbers,
    planar_arm,
    random_moment,
    random_robot,
)

from rmrc.reference import task_metric

# Rounding, times the condition of A: up to (σ₁/σ)² = 1e4, and 100 of B.
LEAST = 1e-8
LEAST_SIGMA = 0.03
# What the pose leaves unseen of a redundant arm is damped, which costs λ²/σ² = 1e-8 over 1e-3.
UNSEEN, DAMPED = 1e-4, 1e-4


def least_twist(rate: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the least [ẋ; y] in ‖·‖_B for a given ẋ: y = −B_yy⁻¹ B_yx ẋ."""
    m = rate.size
    return np.append(rate, -np.linalg.solve(weight[m:, m:], weight[m:, :m] @ rate))


def arms(robot: str, rng: np.random.Generator, folder, links: int) -> Robot:
    """Return an arm that is asked for its whole pose."""
    if robot == "planar":
        return planar_arm(rng.uniform(0.3, 1.2, links), folder)
    return random_robot(robot, rng, folder).asking(*range(6))


@pytest.mark.parametrize("robot", ["planar", "ur5e"])
@examples(20)
@given(numbers)
def test_weighted_moves_the_pose_the_least(robot, tmp_path_factory, number) -> None:
    # The hand's position is given, and its pose moves the least: only its rotation is free.
    rng = np.random.default_rng(number)
    arm = arms(robot, rng, tmp_path_factory.getbasetemp(), 3)
    pose = arm.controller(arm.hand())
    moment = random_moment(pose, rng)
    moment.step(pose)
    jacobian, rate = asked(pose)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    weight = definite(rng, len(arm.rows))
    position = arm.asking(*arm.rows[: 3 if robot == "ur5e" else 2])
    metric = task_metric(jacobian, weight).tolist()
    weighted = position.controller(position.hand(), method="weighted", metric=metric)
    least = least_twist(rate[: len(position.rows)], weight)
    assert_close(jacobian @ moment.step(weighted).v, least, LEAST)


@pytest.mark.parametrize("method", ["weighted", "qp"])
@pytest.mark.parametrize("robot", ["planar", "panda"])
@examples(10)
@given(numbers)
def test_so_does_a_redundant_arm_as_the_damping_of_its_metric_vanishes(
    robot, method, tmp_path_factory, number
) -> None:
    rng = np.random.default_rng(number)
    arm = arms(robot, rng, tmp_path_factory.getbasetemp(), 5)
    pose = arm.controller(arm.hand())
    moment = random_moment(pose, rng)
    moment.step(pose)
    jacobian, rate = asked(pose)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    weight = definite(rng, len(arm.rows))
    with pytest.raises(ValueError, match=f"singular, of rank {len(arm.rows)} for {arm.joints}"):
        task_metric(jacobian, weight)
    position = arm.asking(*arm.rows[: 3 if robot == "panda" else 2])
    metric = task_metric(jacobian, weight, UNSEEN).tolist()
    options = {"method": method, "metric": metric, "priority": "strict"}
    v = moment.step(position.controller(position.hand(), **options)).v
    assert_close(jacobian @ v, least_twist(rate[: len(position.rows)], weight), DAMPED)
