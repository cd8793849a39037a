"""A scene of every kind of geom, and its collision barriers."""

import mujoco
import numpy as np

from rmrc.limits.collision import Collision, collision_pairs
from rmrc.limits.models import CollisionLimit

# A central difference is off by the square of its step times a curvature, up to 1/mm³ at an edge,
# and by the iterative solver's 1e-10 m over the step.
STEP, SLOPE_TOLERANCE = 1e-5, 2e-5
# Analytic pairs and polytopes are exact; of smooth ones the solver's tolerance is 1e-6 m.
DISTANCE_TOLERANCE = 1e-6
# Of overlapping smooth geoms the solver is off by up to a hundredth of the depth; the normal too.
DEEP_TOLERANCE = 2e-3

CUBE = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.07, 0.07))

# Every kind of joint, an obstacle with an arm, and something for each filter to take out.
ZOO = f"""
<mujoco>
  <asset><mesh name="cube" vertex="{CUBE}"/>
    <hfield name="hill" nrow="2" ncol="2" size="1 1 0.1 0.1" elevation="0 1 1 0"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="hill" type="hfield" hfield="hill" pos="5 5 0"/>
    <geom name="wall" type="box" size="0.05 1 1" pos="-1.5 0 1"/>
    <body name="obstacle" mocap="true" pos="0.8 0 0.6">
      <geom name="ball" size="0.1"/>
      <body name="mast" pos="0 0 0.3" euler="0 20 0">
        <geom name="pole" type="capsule" size="0.03 0.15"/></body>
    </body>
    <body name="base" pos="0 0 0.8"><freejoint name="float"/>
      <geom name="trunk" type="mesh" mesh="cube"/>
      <geom name="skin" type="box" size="0.2 0.2 0.2" contype="0" conaffinity="0"/>
      <body name="upper" pos="0.12 0 0.05"><joint name="shoulder" type="ball" pos="0 0.01 0"/>
        <geom name="upper" type="cylinder" size="0.03 0.1" pos="0.1 0 0" euler="0 90 0"/>
        <body name="fore" pos="0.25 0 0"><joint name="extend" type="slide" axis="1 0 0"
            range="-0.05 0.1" limited="true"/>
          <joint name="elbow" axis="0 1 0" pos="-0.02 0 0"/>
          <geom name="fore" type="ellipsoid" size="0.12 0.03 0.04" pos="0.1 0 0"/>
          <geom type="sphere" size="0.02" pos="0.25 0 0"/>
          <body name="fixed" pos="0.28 0 0">
            <geom name="tip" type="box" size="0.02 0.03 0.01"/></body>
        </body>
      </body>
      <body name="tail" pos="-0.12 0 0"><joint name="tail" axis="0 1 0"/>
        <geom name="tail" type="capsule" size="0.02 0.15" pos="-0.2 0 0" euler="0 90 0"/>
        <body name="rattle" pos="-0.4 0 0"><joint axis="0 0 1"/>
          <geom name="rattle" size="0.04" contype="2" conaffinity="2"/></body>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="tail" body2="fore"/><pair geom1="rattle" geom2="wall"/></contact>
</mujoco>
"""


def zoo() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ZOO)


def kinematics(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def barrier(
    model: mujoco.MjModel, twist: np.ndarray | None = None, **limit: object
) -> tuple[Collision, np.ndarray]:
    spec, _ = collision_pairs(model, CollisionLimit.model_validate(limit))
    return spec.build(model, np.zeros((model.nmocap, 6)) if twist is None else twist), spec.geoms


def members(model: mujoco.MjModel, geoms: np.ndarray, *names: str) -> np.ndarray:
    """Return how many geoms of each pair have one of the names."""
    return np.isin(geoms, [model.geom(name).id for name in names]).astype(int).sum(axis=1)


def turned(quaternion: np.ndarray, velocity: np.ndarray, dt: float) -> np.ndarray:
    """Return a rotation (4,) after turning at an angular velocity in the world."""
    rotation, result = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(4)
    mujoco.mju_quatIntegrate(rotation, velocity, dt)
    mujoco.mju_mulQuat(result, rotation, quaternion)
    return result
