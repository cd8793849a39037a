"""Axes that point the opposite way turn at once, and beyond a right angle the error has a slope."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc import Status

DT = 0.002
SECONDS = 3.0
THERE = 0.01
"""rad."""
SLOWER = 1.3
"""Times that the way from 180° may take as long as that from 170°: it may be another way."""
DIFFERENCE = 1e-6
CENTRAL = 1e-6
"""What central differences leave of a Jacobian beside 180°, where it turns within DIFFERENCE."""
SAME = 1e-8
TILT = 0.3
"""rad, of the way to turn against the hand's x axis."""

WRIST = """<mujoco><worldbody><body><joint name="a" axis="0 0 1"/><geom size="0.03"/>
  <body pos="0 0 0.1"><joint name="b" axis="0 1 0"/><geom size="0.03"/>
    <body pos="0 0 0.1"><joint name="c" axis="0 0 1"/><geom size="0.03"/>
      <body pos="0 0 0.1"><joint name="d" axis="0 1 0"/><geom size="0.03"/>
        <site name="hand" pos="0 0 0.1"/></body></body></body></body></worldbody></mujoco>"""


def controller_of(
    tmp_path: Path, robot: str, kind: str, angle: float, engine: Any, **limits: Any
) -> rmrc.Controller:
    """Return a robot whose hand's z axis is to turn by an angle in rad."""
    scene, start = str(REPOSITORY / "scenes" / "panda.xml"), "home"
    if robot == "wrist":
        (tmp_path / "wrist.xml").write_text(WRIST)
        scene, start = str(tmp_path / "wrist.xml"), {"b": 0.7, "d": 0.9}
    task = {"name": "axis", "type": kind, "frame": {"site": "hand"}}

    def compiled(target: Any = None) -> rmrc.Problem:
        given = {} if target is None else {"target": target.tolist()}
        limited = {"velocity": {"default": 2.0}, **limits}
        return rmrc.compile(config(scene, [task | given], start=start, dt=DT, limits=limited))

    problem = compiled()
    data = mujoco.MjData(problem.model)
    data.qpos[:] = problem.start
    mujoco.mj_kinematics(problem.model, data)
    site = data.site("hand")
    x, y, z = site.xmat.reshape(3, 3).T
    target = np.cos(angle) * z + np.sin(angle) * (np.cos(TILT) * x + np.sin(TILT) * y)
    if kind == "look_at":
        target = site.xpos + target
    return rmrc.Controller(compiled(target), engine)


def time_to_turn(controller: rmrc.Controller) -> float:
    """Return when the axis points where it should, s; it comes nearer from the first steps on."""
    before, error = np.inf, np.inf
    for k in range(round(SECONDS / DT)):
        step = controller.step()
        assert Status.STUCK not in step.flags
        error = float(step.error["axis"][0])
        if k < 50:
            assert error < before
        before = error
        if error < THERE:
            return k * DT
    pytest.fail(f"{error:.3g} rad are left")


@pytest.mark.parametrize("engine", ["python", "native"])
@pytest.mark.parametrize("limits", [{}, {"acceleration": {"default": 5.0}}], ids=["free", "slow"])
@pytest.mark.parametrize("kind", ["look_at", "axis_align"])
@pytest.mark.parametrize("robot", ["wrist", "panda"])
def test_it_leaves_the_opposite_way_at_once(
    tmp_path: Path, robot: str, kind: str, limits: dict[str, Any], engine: Any
) -> None:
    if engine == "native":
        pytest.importorskip(
            "rmrc._native", reason="the native extension is not built", exc_type=ImportError
        )
    usual = time_to_turn(controller_of(tmp_path, robot, kind, np.deg2rad(170.0), engine, **limits))
    for angle in (np.deg2rad(179.999), np.pi):
        took = time_to_turn(controller_of(tmp_path, robot, kind, angle, engine, **limits))
        assert took < SLOWER * usual


@pytest.mark.parametrize("kind", ["look_at", "axis_align"])
@pytest.mark.parametrize("angle", [80.0, 89.99, 90.01, 120.0, 170.0, 179.9])
def test_the_jacobian_is_the_errors(tmp_path: Path, kind: str, angle: float) -> None:
    controller = controller_of(tmp_path, "panda", kind, np.deg2rad(angle), "python")
    evaluation, q = controller.engine.evaluation, controller.problem.start
    dofs = controller.problem.dofs

    def error(step: np.ndarray) -> np.ndarray:
        evaluation.move(q, dofs, step)
        return evaluation.error.copy()

    axes = DIFFERENCE * np.eye(dofs.size)
    numeric = np.array([error(-axis) - error(axis) for axis in axes]).T / (2.0 * DIFFERENCE)
    [term] = controller.problem.terms
    assert term.measure(error(0.0 * axes[0]))[0] == pytest.approx(np.deg2rad(angle), abs=SAME)
    np.testing.assert_allclose(evaluation.jacobian, numeric, rtol=0.0, atol=CENTRAL)


@pytest.mark.parametrize("kind", ["look_at", "axis_align"])
@pytest.mark.parametrize("hard", [False, True])
@pytest.mark.parametrize("angle", [100.0, 179.9999, 180.0])
def test_the_engines_agree(tmp_path: Path, kind: str, hard: bool, angle: float) -> None:
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    made = controller_of(tmp_path, "panda", kind, np.deg2rad(angle), "python").problem.config
    task = made.tasks[0].model_copy(update={"hard": hard})
    posture = {"name": "posture", "type": "posture", "level": 1, "B": 0.01}
    problem = rmrc.compile(
        config(
            made.scene,
            [task.model_dump(exclude_unset=True) | {"type": kind}, posture],
            start="home",
            dt=DT,
            # What is hard must be feasible: of the least violation DAQP's tolerance decides.
            limits={"velocity": {"default": 1e3 if hard else 2.0}},
        )
    )
    ours = [rmrc.Controller(problem, name) for name in ("python", "native")]
    for _ in range(20):
        q = ours[0].q
        python, native = (controller.step(q) for controller in ours)
        np.testing.assert_allclose(native.v, python.v, rtol=0.0, atol=SAME * np.abs(python.v).max())
