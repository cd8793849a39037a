"""A first configuration, one frame task and one posture with nothing else said, gets there."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

POSITION, ORIENTATION = 1e-3, 1e-2
"""m and rad, the default tolerances of `converged`."""
SPREAD, INSIDE = 0.4, 0.05
"""How far joints are from the start at the target, rad or m, and how far inside their ranges."""

SCENES = {
    "panda": {"site": "hand"},
    "ur5e": {"site": "tool"},
    "planar_3r": {"site": "hand"},
    "mobile_arm": {"site": "arm_hand"},
    "dual_arm": {"site": "left_hand"},
}
ROBOTS = {
    "aloha/aloha": {"site": "right/right_finger"},
    "franka_emika_panda/panda_nohand": {"site": "attachment_site"},
    "robotiq_2f85/2f85": {"body": "left_silicone_pad"},
    "shadow_hand/right_hand": {"body": "rh_lfdistal"},
    "ufactory_xarm7/xarm7": {"body": "left_inner_knuckle"},
    "wonik_allegro/left_hand": {"body": "th_tip"},
}


def arrives(path: Path, frame: dict[str, str], whole: bool) -> None:
    """Hold a run along a line to a pose, or a point, that the joints can have; by MuJoCo alone."""
    ((kind, name),) = frame.items()
    hand = {"name": "hand", "type": "frame", "frame": frame}
    if not whole:
        hand["B"] = [1, 1, 1, 0, 0, 0]
    tasks: list[dict[str, Any]] = [hand, {"name": "rest", "type": "posture", "level": 1}]
    problem = rmrc.compile(config(str(path), tasks))
    model, data = problem.model, mujoco.MjData(problem.model)
    place = data.site(name) if kind == "site" else data.body(name)
    q, way = problem.start.copy(), np.zeros(model.nv)
    way[problem.dofs] = np.random.default_rng(0).uniform(-SPREAD, SPREAD, problem.dofs.size)
    mujoco.mj_integratePos(model, q, way, 1.0)
    for joint in np.flatnonzero(model.jnt_limited):
        low, high = model.jnt_range[joint]
        margin, at = INSIDE * (high - low), model.jnt_qposadr[joint]
        q[at] = np.clip(q[at], low + margin, high - margin)
    data.qpos = q
    mujoco.mj_kinematics(model, data)
    position, matrix, quaternion = place.xpos.copy(), place.xmat.reshape(3, 3).copy(), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, matrix.ravel())
    to = {"position": position.tolist()} | ({"quaternion": quaternion.tolist()} if whole else {})
    run = rmrc.solve(
        config(
            str(path),
            tasks,
            dt=0.005,
            targets={"hand": {"path": "line", "to": to, "duration": 2.0}},
        )
    )
    data.qpos = run.q[-1]
    mujoco.mj_kinematics(model, data)
    assert np.linalg.norm(place.xpos - position) <= POSITION
    if whole:
        turned = place.xmat.reshape(3, 3).T @ matrix
        assert np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1)) <= ORIENTATION
    assert run.summary["converged"]


@pytest.mark.parametrize("whole", [True, False], ids=["pose", "point"])
@pytest.mark.parametrize("scene", SCENES)
def test_in_a_scene(scene: str, whole: bool) -> None:
    arrives(REPOSITORY / "scenes" / f"{scene}.xml", SCENES[scene], whole)


@pytest.mark.parametrize("whole", [True, False], ids=["pose", "point"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_with_a_robot_of_the_menagerie(menagerie: Path, robot: str, whole: bool) -> None:
    arrives(menagerie / f"{robot}.xml", ROBOTS[robot], whole)
