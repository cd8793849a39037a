"""The Jacobian of a pose error at every angle, in both engines, by finite differences."""

from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

# Richardson's extrapolation leaves STEP⁴ of the curvature, and rounding/STEP of errors near 1.
STEP = 1e-5
FINITE_DIFFERENCE = 1e-8
# Both engines and both kinds of axes are the same closed forms.
SAME = 1e-12
ANGLES = (0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 0.49, 0.51, 2.0, 3.1, 3.14, np.pi - 1e-4)
# A lever, m, which the Jacobian of a small angle has half of.
AWAY = (0.3, 0.1, -0.2)


def evaluated(controller: rmrc.Controller, q: np.ndarray) -> np.ndarray:
    """Evaluate at q, as the engine does, and return the error."""
    engine: Any = controller.engine
    if engine.name == "native":
        engine._evaluate(q)
    else:
        engine.evaluation.update(q)
        engine.evaluation.evaluate()
    return engine.evaluation.error[:6].copy()


@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.parametrize("angle", ANGLES)
def test_the_jacobian_is_exact(engine: str, axes: str, angle: float) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "axes": axes}
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    problem = rmrc.compile(config(scene, [hand], start="home"))
    controller = rmrc.Controller(problem, engine)  # type: ignore
    model, q, target = problem.model, problem.start, problem.term["hand"].target
    axis = np.random.default_rng(0).normal(size=3)
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, axis / np.linalg.norm(axis), angle)
    mujoco.mju_mulQuat(turned, target[:4], turn)
    assert controller.set_target("hand", target[4:] + AWAY, turned)
    evaluated(controller, q)
    jacobian = controller.engine.evaluation.jacobian[:6].copy()
    for dof in range(model.nv):
        way, slopes = np.eye(model.nv)[dof], []
        for step in (STEP, 2.0 * STEP):
            ends = []
            for sign in (1.0, -1.0):
                moved = q.copy()
                mujoco.mj_integratePos(model, moved, way, sign * step)
                ends.append(evaluated(controller, moved))
            slopes.append((ends[1] - ends[0]) / (2.0 * step))
        slope = (4.0 * slopes[0] - slopes[1]) / 3.0
        assert np.abs(jacobian[:, dof] - slope).max() < FINITE_DIFFERENCE


def test_the_command_does_not_jump_as_an_angle_passes(engine: str) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    problem = rmrc.compile(config(scene, [hand], start="home"))
    controller, target = rmrc.Controller(problem, engine), problem.term["hand"].target  # type: ignore
    commands = []
    for angle in (0.0, 0.9e-5, 1.1e-5):
        controller.reset()
        turn, turned = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), angle)
        mujoco.mju_mulQuat(turned, target[:4], turn)
        controller.set_target("hand", target[4:] + 0.1 * np.array(AWAY), turned)
        commands.append(controller.step().v)
    # 10/s of 1e-5 rad, by an inverse Jacobian of about 10.
    assert np.abs(commands[1] - commands[0]).max() < 1e-2
    assert np.abs(commands[2] - commands[1]).max() < 1e-2
