"""The forward kinematics in C++, held to MuJoCo's at random configurations."""

import platform
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from models import REPOSITORY

pytest.importorskip("rmrc._native")

from rmrc.native.kinematics import ARRAYS, Watched, build

Array = NDArray[np.float64]

CONFIGURATIONS = 1000
ROUNDING = 1e-14
"""Relative to the largest of 1 and the number itself."""
FARTHEST = 10.0
"""m, of free bodies and mocap bodies."""

EVERY_JOINT = """
<mujoco>
  <worldbody>
    <body mocap="true" pos="1 0 0.2"><geom size="0.1"/>
      <body pos="0.1 0.2 0.3" euler="20 30 40"><geom type="box" size="0.1 0.2 0.3"/></body>
    </body>
    <body pos="0.3 0.1 0.2" euler="10 0 30"><geom size="0.1" pos="0.1 0 0"/>
      <body pos="0 0 0.3" euler="0 50 0">
        <joint type="slide" axis="1 2 3" ref="0.2"/>
        <joint type="hinge" axis="0 1 1" pos="0.1 0.2 0.1" ref="20"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0.1 0.2 0.3"/>
        <site name="tilted" pos="0.1 0 0" euler="1 2 3"/>
        <body pos="0.2 0 0.1">
          <joint type="ball" pos="0 0.1 0"/><geom type="ellipsoid" size="0.1 0.2 0.1"/>
          <body><joint axis="1 0 0" pos="0 0 1"/><geom size="0.05" pos="0 0 0.3"/></body>
        </body>
      </body>
    </body>
    <body name="free" pos="2 0 0"><freejoint/><geom type="box" size="0.1 0.2 0.3" pos="0 0.1 0"/>
      <body pos="0.3 0 0" euler="0 0 45"><joint/><geom size="0.1" mass="0.1"/></body>
      <body pos="0 0 0.3"><joint type="slide" axis="1 0 0"/><geom size="0.1"/><site/></body>
    </body>
  </worldbody>
</mujoco>
"""
SCENES = sorted((REPOSITORY / "scenes").glob("*.xml"))
ROBOTS = {
    "panda": "franka_emika_panda/scene.xml",
    "ur5e": "universal_robots_ur5e/scene.xml",
    "iiwa": "kuka_iiwa_14/scene.xml",
    "g1": "unitree_g1/scene.xml",
    "aloha": "aloha/scene.xml",
    "shadow hand": "shadow_hand/scene_right.xml",
}


def everything(model: mujoco.MjModel) -> Watched:
    watched = Watched()
    watched.bodies.update(range(model.nbody))
    watched.geoms.update(range(model.ngeom))
    watched.sites.update(range(model.nsite))
    watched.subtrees.add(0)
    return watched


def scatter(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Go to a random configuration, with quaternions that are not of norm 1."""
    data.mocap_pos[:] = rng.uniform(-FARTHEST, FARTHEST, data.mocap_pos.shape)
    data.mocap_quat[:] = rng.normal(size=data.mocap_quat.shape)
    data.qpos[:] = model.qpos0 + rng.uniform(-3.0, 3.0, model.nq)


def axes_at_roots(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return MuJoCo's axes of the dofs, moved from the centres of mass to the roots' origins."""
    roots, axes = model.body_rootid[model.dof_bodyid], data.cdof.copy()
    offset = data.xpos[roots] - data.subtree_com[roots]
    axes[:, 3:] += np.cross(axes[:, :3], offset)
    return axes


def apart(ours: Array, theirs: Array) -> float:
    """Return the largest difference, relative to the largest of 1 and all numbers."""
    return float(np.abs(ours - theirs).max(initial=0.0) / np.abs(theirs).max(initial=1.0))


def hold(model: mujoco.MjModel) -> None:
    """Hold all numbers to MuJoCo's."""
    ours, theirs = mujoco.MjData(model), mujoco.MjData(model)
    axes, rng = np.zeros((model.nv, 6)), np.random.default_rng(0)
    native = build(model, ours, axes, everything(model))
    for _ in range(CONFIGURATIONS):
        scatter(model, theirs, rng)
        ours.mocap_pos[:], ours.mocap_quat[:] = theirs.mocap_pos, theirs.mocap_quat
        native.update(theirs.qpos)
        mujoco.mj_kinematics(model, theirs)
        mujoco.mj_comPos(model, theirs)
        for name in ARRAYS:
            found, expected = getattr(ours, name), getattr(theirs, name)
            if name != "subtree_com" and platform.machine() == "x86_64":
                # To the last bit: distances of meshes jump with it.
                np.testing.assert_array_equal(found, expected, err_msg=name)
            assert apart(found, expected) < ROUNDING, name
        assert apart(axes, axes_at_roots(model, theirs)) < ROUNDING


def test_every_kind_of_joint() -> None:
    hold(mujoco.MjModel.from_xml_string(EVERY_JOINT))


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_scenes(scene: Path) -> None:
    hold(mujoco.MjModel.from_xml_path(str(scene)))


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_of_the_menagerie(robot: str, menagerie: Path) -> None:
    hold(mujoco.MjModel.from_xml_path(str(menagerie / ROBOTS[robot])))
