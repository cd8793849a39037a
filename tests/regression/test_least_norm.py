"""The pseudo-inverse has the least ‖q̇‖ of all solutions: any other adds what is orthogonal to it."""

import numpy as np
import pytest
from hypothesis import assume, given
from robots import (
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

# Rounding, times the condition σ₁/σ and that of a metric, 100.
SOLVED = 1e-9
LEAST_SIGMA = 0.02

POSTURE = {"name": "posture", "type": "posture", "level": 1}


@each_robot
@examples(15)
@given(numbers)
def test_no_other_solution_is_shorter(robot, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    pinv = arm.controller(arm.hand(), method="pinv")
    moment = random_moment(pinv, rng)
    v = moment.step(pinv).v
    jacobian, rate = asked(pinv)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    metric = definite(rng, v.size).tolist()
    fastest = np.abs(v).max()
    others = {
        "weighted": arm.controller(arm.hand(), method="weighted", metric=metric),
        "nullspace": arm.controller(arm.hand(), POSTURE, method="nullspace"),
        "strict": arm.controller(arm.hand(), POSTURE, priority="strict"),
        "saturated": arm.controller(
            arm.hand(),
            method="saturated",
            limits={"position": "off", "velocity": {"default": 0.98 * fastest}},
        ),
    }
    for name, controller in others.items():
        other = moment.step(controller).v
        moved = jacobian @ other
        if name == "saturated":  # holds the task only where the others can take over
            assume(np.abs(moved - rate).max() <= SOLVED * max(1.0, fastest))
        assert_close(moved, rate, SOLVED)
        added = other - v
        # ‖other‖² = ‖v‖² + ‖added‖², as v ⟂ null space.
        assert abs(added @ v) <= SOLVED * max(1.0, np.linalg.norm(added) * np.linalg.norm(v))
        assert np.linalg.norm(other) >= np.linalg.norm(v)
