"""What the tasks share that point an axis of a frame: `look_at` and `axis_align`."""

from dataclasses import dataclass
from typing import Any, ClassVar

import mink
import mujoco
import numpy as np

from rmrc.config.base import Direction, Frame, NonNegative
from rmrc.problem.frames import FrameHandle, resolve
from rmrc.problem.tasks.base import Array, GainedTask, HardTask, Way, weight_array
from rmrc.problem.tasks.mink_tasks import MinkTerm


class PointingTask(HardTask, GainedTask):
    """Point an axis of a frame somewhere; the roll about the axis stays free."""

    B: NonNegative = 1.0
    """Weight of the squared difference of the two unit vectors, a number."""
    frame: Frame
    """The frame that turns."""
    axis: Direction = (0.0, 0.0, 1.0)
    """The axis that points, in the frame's own coordinates."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the frame's body."""
        return [resolve(model, self.frame).body(model)]

    def pointing(self, model: mujoco.MjModel, start: Array) -> tuple[dict[str, Any], mink.SE3]:
        """Return what the term takes over but for its target, and the frame's pose at the start."""
        handle = resolve(model, self.frame)
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        fields = self.common() | {"weight": weight_array(self.B, 3), "frame": handle, "axis": axis}
        return fields, mink.SE3(handle.pose_at(model, start))


@dataclass(frozen=True, eq=False, kw_only=True)
class PointingTerm(MinkTerm):
    """Rows e = d − a for the unit vector a along the axis and the direction d that it is to have.

    Both are in the frame's own coordinates.
    """

    decisive: ClassVar[bool] = True
    bends: ClassVar[bool] = True

    frame: FrameHandle
    axis: Array

    def way(self, model: mujoco.MjModel) -> Way:
        """Return the dofs on the way to the frame."""
        return Way.chain(self.frame.dofs(model))

    @property
    def frames(self) -> tuple[FrameHandle, ...]:
        """The frame."""
        return (self.frame,)

    @property
    def units(self) -> tuple[str, ...]:
        """The angle."""
        return ("rad",)

    def measure(self, error: Array) -> Array:
        """Return the angle in rad between two unit vectors of difference e: 2 asin(‖e‖/2)."""
        half = 0.5 * float(np.sqrt(error @ error))
        return np.array([2.0 * np.arcsin(min(half, 1.0))])

    def attainable(self, error: Array, rate: Array) -> Array:
        """Return the part of ẋ that turns the unit vector d = e + a, at right angles to it.

        The rest would lengthen d: the three rows of an axis have rank two.
        """
        direction = error + self.axis
        return rate - direction * (direction @ rate)
