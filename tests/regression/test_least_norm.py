"""The pseudo-inverse has the least ‖q̇‖ of all solutions: any other adds to it at right angles."""

import numpy as np
import pytest
from hypothesis import assume, given
from random_robots import (
    asked,
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
    unit_links,
)

# The strict QP is damped by 1e-12, which moves it by that over σ² ≥ 4e-4.
SOLVED = 1e-8
LEAST_SIGMA = 0.02

POSTURE = {"name": "posture", "type": "posture", "level": 1}


@each_robot
@examples(15)
@given(numbers)
def test_every_other_solution_is_longer_by_what_it_adds(robot, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    pinv = arm.controller(arm.hand(), method="pinv")
    moment = random_moment(pinv, rng)
    v = moment.step(pinv).v
    jacobian, rate = asked(pinv)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    assert_close(jacobian @ v, rate, SOLVED)
    metric = definite(rng, v.size).tolist()
    for controller in (
        arm.controller(arm.hand(), method="weighted", metric=metric),
        arm.controller(arm.hand(), POSTURE, method="nullspace"),
        arm.controller(arm.hand(), POSTURE, priority="strict"),
    ):
        other = moment.step(controller).v
        assert_close(jacobian @ other, rate, SOLVED)
        added = np.linalg.norm(other - v)
        assert added > 10.0 * SOLVED or len(rate) == v.size
        assert np.linalg.norm(other) == pytest.approx(
            np.hypot(np.linalg.norm(v), added), rel=SOLVED
        )


@pytest.mark.parametrize(
    ("dofs", "expected"),
    [
        (None, [3 / 14, 2 / 14, 1 / 14]),  # ‖v‖ = 1/√14 = 0.267 rad/s
        (["joint1"], [1 / 3, 0, 0]),
        (["joint2"], [0, 1 / 2, 0]),
        (["joint3"], [0, 0, 1]),
    ],
)
def test_a_straight_arm_moves_across_by_all_its_joints(dofs, expected) -> None:
    # Across unit links along x, J = [3, 2, 1]; 1 m/s is asked for.
    arm = unit_links(3)
    across = {**arm.hand(axes="world"), "B": [0, 1, 0, 0, 0, 0]}
    controller = arm.controller(across, method="pinv", start=[0.0, 0.0, 0.0], dofs=dofs)
    controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 1, 0, 0, 0, 0])
    assert controller.step().v == pytest.approx(expected, abs=SOLVED)
