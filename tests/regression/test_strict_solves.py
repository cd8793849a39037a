"""The strict cascade brakes nowhere: v = 0 is feasible at its first level, and N z = 0 below."""

from dataclasses import replace

import numpy as np
import pytest
from random_robots import Moment, asked, definite, random_moment, random_robot

import rmrc

MOMENTS = 200
# J v along ẋ: DAQP's tolerance, beside a v of the order of 0.1.
ALONG = 1e-6


def within_ranges(controller: rmrc.Controller, moment: Moment) -> Moment:
    """Return the same moment with every joint inside its range."""
    model, q = controller.problem.model, moment.q.copy()
    hinges = np.flatnonzero(model.jnt_limited)
    low, high = model.jnt_range[hinges].T
    at = model.jnt_qposadr[hinges]
    q[at] = np.clip(q[at], low + 0.01, high - 0.01)
    return replace(moment, q=q)


@pytest.mark.parametrize("damping", [0.0, 1e-5, 1e-3, 0.1])
@pytest.mark.parametrize("robot", ["planar", "panda", "ur5e"])
def test_one_level_is_solved_whatever_the_damping(robot, damping, tmp_path) -> None:
    rng = np.random.default_rng(0)
    arm = random_robot(robot, rng, tmp_path)
    rows = (0, 1) if robot == "planar" else tuple(range(6))
    controller = arm.asking(*rows).controller(
        arm.asking(*rows).hand(gain=1.0),
        priority="strict",
        limits={"velocity": {"default": 0.1}},
        damping={"lambda": damping},
    )
    braked = sum(
        within_ranges(controller, random_moment(controller, rng)).step(controller).status
        is rmrc.Status.MAX_ITER
        for _ in range(MOMENTS)
    )
    assert not braked


@pytest.mark.parametrize("robot", ["planar", "panda", "ur5e", "biped"])
def test_levels_inside_limits_are_solved(robot, tmp_path) -> None:
    rng = np.random.default_rng(5)
    arm = random_robot(robot, rng, tmp_path)
    controller = arm.controller(
        arm.hand(definite(rng, len(arm.rows))),
        {"name": "root", "type": "frame", "frame": arm.root, "axes": "world"},
        {"name": "com", "type": "com", "B": definite(rng, 3).tolist(), "level": 1},
        {"name": "look", "type": "look_at", "frame": {"site": arm.site}, "level": 1},
        {"name": "posture", "type": "posture", "B": 0.1, "level": 2},
        priority="strict",
        limits={"velocity": {"default": 0.3}},
        damping={"lambda": 0.1},
    )
    for far in ("root", "com"):
        assert controller.set_target(far, rng.normal(size=3))
    braked = sum(
        random_moment(controller, rng).step(controller).status is rmrc.Status.MAX_ITER
        for _ in range(MOMENTS)
    )
    assert not braked


@pytest.mark.parametrize("robot", ["planar", "panda", "ur5e", "biped"])
def test_a_direction_is_kept_wherever_there_is_room(robot, tmp_path) -> None:
    rng = np.random.default_rng(0)
    arm = random_robot(robot, rng, tmp_path)
    controller = arm.controller(
        arm.hand(gain=1.0, preserve="direction"),
        limits={"velocity": {"default": 0.1}},
        damping={"lambda": 0.01},
    )
    for _ in range(MOMENTS):
        v = within_ranges(controller, random_moment(controller, rng)).step(controller).v
        jacobian, rate = asked(controller)
        along = (jacobian @ v) @ rate / (rate @ rate) * rate
        assert np.linalg.norm(jacobian @ v - along) <= ALONG
        assert np.abs(v).max() > ALONG
