"""Ranges of ball joints: the rotation angle stays below its limit."""

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.barrier import Barrier, Near
from rmrc.limits.joints import held_ranges, joint_name
from rmrc.limits.models import LimitsModel

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class BallRanges:
    """The ranges of a problem's ball joints."""

    joints: Ids
    """The joints (k,)."""
    largest: Array
    """θ_max − margin of each (k,), rad."""
    gain: float
    """Share of the remaining angle that a step may use."""

    def build(self, model: mujoco.MjModel, obstacle_twist: Array) -> "BallRange":
        """Return the barrier; nothing but the joints themselves moves it."""
        return BallRange(model, self)


def compile_balls(
    model: mujoco.MjModel, limits: LimitsModel, dofs: NDArray[np.intp]
) -> list[BallRanges]:
    """Return the ranges of the ball joints that may move, if there are any."""
    if limits.position == "off":
        return []
    largest = held_ranges(model, limits)[:, 1] - limits.position.margin
    joints = np.flatnonzero(
        (model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
        & np.isin(model.jnt_dofadr, dofs)
        & (largest < np.pi)
    )
    return [BallRanges(joints, largest[joints], limits.position.gain)] if joints.size else []


class BallRange(Barrier):
    """h = θ_max − θ with the angle θ = ‖log q‖ in [0, π] of each ball joint.

    A ball joint's velocity ω is in the axes of the body that it moves, q' = q exp(ω dt), and its
    component along the axis u = log q/θ is the rate of the angle, so that ∂h/∂q v = −uᵀω. At θ = 0
    any direction leads away from there, and u is the first axis.

    All ball joints always have their row: with acceleration limits one may bind long before a
    step can bring θ to its limit.
    """

    kind: ClassVar[str] = "position"
    unit: ClassVar[str] = "rad"

    def __init__(self, model: mujoco.MjModel, spec: BallRanges):
        self.gain, self.push = spec.gain, math.inf  # the box says how fast a joint comes back
        self._model, self.spec = model, spec
        self.size = count = spec.joints.size
        self._ids = np.arange(count)
        self._quaternion = model.jnt_qposadr[spec.joints][:, None] + np.arange(4)
        self._dofs = model.jnt_dofadr[spec.joints][:, None] + np.arange(3)
        self._none = np.zeros(count)

    def near(self, data: mujoco.MjData, travel: Array, dt: float) -> Near:
        """Return all joints."""
        angle, axis = self._rotation(data)
        slope = np.zeros((self._ids.size, self._model.nv))
        np.put_along_axis(slope, self._dofs, -axis, axis=1)
        return Near(self._ids, self.spec.largest - angle, slope, self._none)

    def distances(self, data: mujoco.MjData, ids: Ids) -> Array:
        """Return h of some joints (k,)."""
        return (self.spec.largest - self._rotation(data)[0])[ids]

    def reach(self, ids: Ids, step: Array, dt: float) -> Array:
        """Return ‖Δq‖ of each joint: no rotation adds more than its own angle to another."""
        return np.linalg.norm(step[self._dofs[ids]], axis=1)

    def name(self, identity: int) -> str:
        """Return the joint's name."""
        return joint_name(self._model, int(self.spec.joints[identity]))

    def least(self, data: mujoco.MjData) -> tuple[float, int]:
        """Return the least h and the joint's place in the list."""
        distances = self.distances(data, self._ids)
        least = int(np.argmin(distances))
        return float(distances[least]), least

    def _rotation(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return the angles (k,) and the axes (k, 3) of the joints' rotations."""
        quaternion = data.qpos[self._quaternion]
        vector = quaternion[:, 1:] * np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)
        sine = np.linalg.norm(vector, axis=1)
        angle = 2.0 * np.arctan2(sine, np.abs(quaternion[:, 0]))
        axis = np.tile([1.0, 0.0, 0.0], (sine.size, 1))
        np.divide(vector, sine[:, None], out=axis, where=sine[:, None] > 0.0)
        return angle, axis
