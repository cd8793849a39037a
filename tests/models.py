"""Models and configurations that several tests use."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import rmrc

REPOSITORY = Path(__file__).resolve().parent.parent

PENDULUM = """
<mujoco>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0.3 1 0.2" range="-2 2" limited="true"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0.5 0.1 0.2" size="0.02"/>
      <site name="tip" pos="0.5 0.1 0.2"/>
      <site name="middle" pos="0.2 0 0.1" euler="10 20 30"/>
    </body>
    <body name="post"><geom type="sphere" size="0.01"/><site name="root" pos="0.1 0.1 0"/></body>
  </worldbody>
</mujoco>
"""

# Ball joints and others under a body that may be moved, and planes for what hangs on them.
CHAIN = """
<mujoco>
  <compiler angle="radian"/>
  <default><geom type="sphere" size="0.05"/></default>
  <worldbody>
    <body name="cart" mocap="true" pos="0.2 0 0.1">
      <geom/>
      <body name="shoulder" pos="0 0.1 0.3" euler="0.3 0.2 0.1">
        <joint name="shoulder" type="ball" range="0 1.2" pos="0.02 0 0.05"/><geom/>
        <body name="forearm" pos="0.3 0 0.1" euler="0 0.4 0.7">
          <joint name="slide" type="slide" axis="1 0 1" range="-0.2 0.3"/>
          <joint name="elbow" axis="0 1 0" pos="0.1 0 0"/>
          <geom name="ball" type="capsule" size="0.03 0.1" pos="0.1 0.1 0"/>
          <body name="hand" pos="0.25 0.05 0" euler="0.5 0 0.2">
            <joint name="wrist" type="ball" range="0 0.6"/>
            <geom type="ellipsoid" size="0.05 0.03 0.08"/>
            <site name="tip" pos="0.05 0.02 0.1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
PLANES = (
    {"frame": {"site": "tip"}, "normal": [0, 0, 2], "offset": 0.1},
    {"frame": {"geom": "ball"}, "normal": [1, -1, 0.5], "offset": -0.3},
    {"frame": {"body": "hand"}, "normal": [0, 1, 0], "offset": 0.2},
)

# Scene, a site that moves, another frame of the robot, for nv = 1, 6, 7 and a floating base.
ROBOTS = {
    "pendulum": ("tip", {"site": "root"}),
    "ur5e": ("tool", {"body": "forearm_link"}),
    "panda": ("hand", {"body": "link4"}),
    "biped": ("left_hand", {"site": "head"}),
}

# Those of the Menagerie: the model's file, and the frame that a task moves.
MENAGERIE = {
    "panda": ("franka_emika_panda/panda_nohand", {"site": "attachment_site"}),
    "ur5e": ("universal_robots_ur5e/ur5e", {"site": "attachment_site"}),
    "iiwa": ("kuka_iiwa_14/iiwa14", {"site": "attachment_site"}),
    "g1": ("unitree_g1/g1", {"site": "left_palm"}),
    "aloha": ("aloha/aloha", {"site": "left/gripper"}),
    "shadow": ("shadow_hand/right_hand", {"body": "rh_ffdistal"}),
}


def scene_path(name: str, folder: Path) -> str:
    """Return the path of a scene; the pendulum is written into a folder first."""
    if name != "pendulum":
        return str(REPOSITORY / "scenes" / f"{name}.xml")
    path = folder / "pendulum.xml"
    path.write_text(PENDULUM)
    return str(path)


def config(scene: Any, tasks: list[dict[str, Any]], **others: Any) -> rmrc.Config:
    """Return a configuration from plain data."""
    return rmrc.Config.model_validate({"scene": scene, "tasks": tasks, **others})


def random_configuration(
    model: mujoco.MjModel, start: NDArray[np.float64], rng: np.random.Generator, spread: float
) -> NDArray[np.float64]:
    """Return a configuration a random tangent step of the given size away from the start."""
    q = start.copy()
    mujoco.mj_integratePos(model, q, rng.uniform(-spread, spread, model.nv), 1.0)
    return q


def random_quaternion(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a unit quaternion wxyz."""
    quaternion = rng.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)
