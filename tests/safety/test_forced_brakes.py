"""What must give way although the time is over, and by how much."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import rmrc
from models import config
from rmrc.control.status import Status

D_MIN = 0.05
KEPT = 1e-6
"""m; `rmrc.model.extents.FINEST`."""
STEPS = 150
DT = 0.01
DECELERATION = 2.0

# The joint comes back into its range as fast as it may, towards a wall.
SCENE = """<mujoco><worldbody>
  <body><joint name="x" type="slide" axis="1 0 0" range="1 2" limited="true"/>
    <geom name="car" size="0.05"/><site name="tip"/></body>
  <geom name="wall" size="0.05" pos="0.6 0 0"/>
</worldbody></mujoco>"""


LEAST = 1e-6
"""Share by which a violation may be above the least one."""

# Contradictory rows a hundred thousand times as long as one that can hold.
HINGES = """<mujoco><worldbody>
  <body><joint name="a" axis="0 0 1"/><geom size="0.05"/></body>
  <body><joint name="b" axis="0 0 1"/><geom size="0.05"/></body>
</worldbody></mujoco>"""
LONG, SHORT = 1500.0, 0.015
OFFSETS = (0.0, 0.1, 2e-4)


def test_rows_of_all_lengths_give_way_by_the_least(tmp_path: Path, engine: Any) -> None:
    """‖E v − f‖ is that of scipy's bounded least squares where two of three rows contradict."""
    (tmp_path / "scene.xml").write_text(HINGES)
    rows = [("a", LONG), ("a", LONG), ("b", SHORT)]
    problem = rmrc.compile(
        config(
            str(tmp_path / "scene.xml"),
            [
                {"name": f"row{k}", "type": "coupling", "coefficients": {joint: c}, "offset": off}
                for k, ((joint, c), off) in enumerate(zip(rows, OFFSETS, strict=True))
            ],
        )
    )
    step = rmrc.Controller(problem, engine).step()
    matrix = np.array([[c, 0.0] if joint == "a" else [0.0, c] for joint, c in rows])
    right = 100.0 * np.array(OFFSETS)  # K e at q = 0
    fastest = problem.box.velocity
    least = lsq_linear(matrix, right, (-fastest, fastest), tol=1e-14).x
    missed, fewest = (np.linalg.norm(matrix @ v - right) for v in (step.v, least))
    assert missed <= (1.0 + LEAST) * fewest
    assert step.v == pytest.approx(least, rel=1e-4)  # the short row's share is lost in the norm
    assert Status.RELAXED in step.flags


@pytest.mark.parametrize("deadline", [None, 20.0, 1.0])
def test_a_brake_that_is_forced_on_says_so(
    tmp_path: Path, engine: Any, deadline: float | None
) -> None:
    """No way to rest falls below the limit unless the step is RELAXED, whatever its deadline."""
    (tmp_path / "scene.xml").write_text(SCENE)
    problem = rmrc.compile(
        config(
            str(tmp_path / "scene.xml"),
            [{"name": "tip", "type": "frame", "frame": {"site": "tip"}}],
            dt=DT,
            solver={"deadline": deadline},
            limits={
                "velocity": {"default": 1.0},
                "acceleration": {"default": DECELERATION},
                "collision": {"pairs": "all", "d_min": D_MIN, "detect": 0.3},
            },
        )
    )
    data = mujoco.MjData(problem.model)

    def distance(x: float) -> float:
        data.qpos[:] = x
        mujoco.mj_kinematics(problem.model, data)
        return mujoco.mj_geomDistance(problem.model, data, 0, 1, 9.0, None)

    controller, q = rmrc.Controller(problem, engine), np.zeros(1)
    for _ in range(STEPS):
        before, step = distance(float(q[0])), controller.step(q)
        end, speed = float(step.q[0]), float(step.v[0])
        while speed > 0.0:
            speed = max(speed - DECELERATION * DT, 0.0)
            end += speed * DT
        kept = distance(end) >= min(before, D_MIN) - KEPT
        assert kept or Status.RELAXED in step.flags
        q = step.q


BALL = """<mujoco><worldbody><body>
  <joint name="ball" type="ball"/><geom size="0.1"/><site name="tip" pos="0.3 0 0"/>
</body></worldbody></mujoco>"""


def test_a_ball_that_is_too_fast_sheds_all_that_it_can(tmp_path: Path, engine: Any) -> None:
    """A brake about the axis is inside the order of the limits: acceleration, then velocity."""
    (tmp_path / "scene.xml").write_text(BALL)
    problem = rmrc.compile(
        config(
            str(tmp_path / "scene.xml"),
            [{"name": "tip", "type": "frame", "frame": {"site": "tip"}}],
            dt=DT,
            limits={"velocity": {"default": 1.0}, "acceleration": {"default": DECELERATION}},
        )
    )
    controller, before = rmrc.Controller(problem, engine), np.array([1.2, 3.0, 0.1])
    controller.reset(problem.start, before)
    for _ in range(STEPS):
        step = controller.step(np.full(4, np.nan))
        assert Status.INVALID_INPUT in step.flags
        assert (np.abs(step.v) <= np.maximum(1.0, before - DECELERATION * DT) + KEPT).all()
        assert (np.abs(step.v - before) <= DECELERATION * DT + KEPT).all()
        before = step.v
