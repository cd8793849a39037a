"""`nullspace`, the prioritised recursion, is the strict QP, and leaves the highest level alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from random_robots import (
    Robot,
    asked,
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
)

# Past three levels of two SVDs and a program each, of conditions up to 1e6.
STRICT = 1e-8

dampings = st.floats(0.01, 1.0)


def three_levels(robot: str, rng: np.random.Generator, folder) -> tuple[Robot, list[dict]]:
    """Return the hand's position, then a frame's and the centre of mass', then a posture."""
    arm = random_robot(robot, rng, folder)
    hand = arm.asking(*arm.rows[:3])
    root = {"name": "root", "type": "frame", "frame": arm.root, "level": 1}
    com = {"name": "com", "type": "com", "B": definite(rng, 3).tolist(), "level": 1}
    posture = {"name": "posture", "type": "posture", "level": 2}
    return hand, [hand.hand(definite(rng, len(hand.rows))), root, com, posture]


@each_robot
@examples(15)
@given(numbers, dampings)
def test_nullspace_is_the_strict_qp(robot, tmp_path_factory, number, damping) -> None:
    rng = np.random.default_rng(number)
    arm, tasks = three_levels(robot, rng, tmp_path_factory.getbasetemp())
    options = {"damping": {"lambda": damping}, "priority": "strict"}
    qp, nullspace = (arm.controller(*tasks, method=m, **options) for m in ("qp", "nullspace"))
    moment = random_moment(qp, rng)
    assert_close(moment.step(nullspace).v, moment.step(qp).v, STRICT)


@each_robot
@examples(10)
@given(numbers, dampings, st.floats(1e-3, 1.0))
def test_nullspace_is_strict_whatever_is_said_of_soft_levels(
    robot, tmp_path_factory, number, damping, ratio
) -> None:
    rng = np.random.default_rng(number)
    arm, tasks = three_levels(robot, rng, tmp_path_factory.getbasetemp())
    options = {"method": "nullspace", "damping": {"lambda": damping}}
    strict = arm.controller(*tasks, priority="strict", **options)
    soft = arm.controller(*tasks, priority="soft", soft_ratio=ratio, **options)
    moment = random_moment(strict, rng)
    assert_close(moment.step(soft).v, moment.step(strict).v, STRICT)


@each_robot
@examples(10)
@given(numbers, dampings)
def test_lower_levels_do_not_move_the_highest(robot, tmp_path_factory, number, damping) -> None:
    rng = np.random.default_rng(number)
    arm, tasks = three_levels(robot, rng, tmp_path_factory.getbasetemp())
    options = {"damping": {"lambda": damping}, "priority": "strict"}
    alone = arm.controller(tasks[0], method="dls", **options)
    moment = random_moment(alone, rng)
    v = moment.step(alone).v
    jacobian, _ = asked(alone)
    for method in ("qp", "nullspace"):
        full = moment.step(arm.controller(*tasks, method=method, **options)).v
        assert_close(jacobian @ full, jacobian @ v, STRICT)
        assert len(v) == len(arm.rows) or np.linalg.norm(full - v) > STRICT
