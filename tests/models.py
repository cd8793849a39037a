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

# Scene, a site that moves, another frame of the robot, for nv = 1, 6, 7 and a floating base.
ROBOTS = {
    "pendulum": ("tip", {"site": "root"}),
    "ur5e": ("tool", {"body": "forearm_link"}),
    "panda": ("hand", {"body": "link4"}),
    "biped": ("left_hand", {"site": "head"}),
}


def scene_path(name: str, folder: Path) -> str:
    """Return the path of a scene; the pendulum is written into a folder first."""
    if name != "pendulum":
        return str(REPOSITORY / "scenes" / f"{name}.xml")
    path = folder / "pendulum.xml"
    path.write_text(PENDULUM)
    return str(path)


def config(scene: str, tasks: list[dict[str, Any]], **others: Any) -> rmrc.Config:
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
