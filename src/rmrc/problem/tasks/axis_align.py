"""The `axis_align` task: an axis of a frame points along a direction of the world."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import mink
import mujoco
import numpy as np

from rmrc.config.base import Direction, Frame, NonNegative
from rmrc.problem.frames import FrameHandle, resolve
from rmrc.problem.tasks.base import (
    Array,
    GainedTask,
    HardTask,
    TargetKind,
    gain_value,
    weight_array,
)
from rmrc.problem.tasks.mink_tasks import MinkTerm, look_at_units, tangential


class AxisAlignTask(HardTask, GainedTask):
    """Point an axis of a frame along a direction of the world; the roll about it stays free."""

    target_kind: ClassVar[TargetKind] = "direction"

    type: Literal["axis_align"] = "axis_align"
    B: NonNegative = 1.0
    """Weight of the squared difference of the two unit vectors, a number."""
    frame: Frame
    """The frame that turns."""
    axis: Direction = (0.0, 0.0, 1.0)
    """The axis that points, in the frame's own coordinates."""
    target: Direction | None = None
    """The direction in the world; by default the axis' own at the start."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "AxisAlignTerm":
        """Resolve the frame."""
        handle = resolve(model, self.frame)
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        rotation = mink.SE3(handle.pose_at(model, start)).rotation()
        target = rotation.apply(axis) if self.target is None else np.array(self.target)
        return AxisAlignTerm(
            name=self.name,
            type=self.type,
            level=self.level,
            hard=self.hard,
            gain=gain_value(self.gain),
            weight=weight_array(self.B, 3),
            target=target / np.linalg.norm(target),
            frame=handle,
            axis=axis,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class AxisAlignTerm(MinkTerm):
    """Rows of an `axis_align` task, by mink's AxisAlignTask: e = Rᵀt − a."""

    target_kind: ClassVar[TargetKind] = "direction"
    decisive: ClassVar[bool] = True

    frame: FrameHandle
    axis: Array

    @property
    def units(self) -> tuple[str, ...]:
        """The angle."""
        return ("rad",)

    def measure(self, error: Array) -> Array:
        """Return the angle in rad between the axis and the target."""
        return look_at_units(error)

    def attainable(self, error: Array, rate: Array) -> Array:
        """Return the part of ẋ that turns the axis."""
        return tangential(self.axis, error, rate)

    def task(self) -> mink.AxisAlignTask:
        """Return mink's task with unit cost and gain."""
        return mink.AxisAlignTask(self.frame.id, self.frame.kind, self.axis)

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target direction."""
        assert isinstance(task, mink.AxisAlignTask)
        task.set_target(target)

    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return Rᵀ (ω × t) for the direction's angular velocity ω, the twist's second half."""
        pose = configuration.get_transform_frame_to_world(self.frame.id, self.frame.kind)
        return pose.rotation().as_matrix().T @ np.cross(twist[3:], target)
