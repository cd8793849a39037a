"""The `look_at` task: an axis of a frame points at a target point."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import mink
import mujoco
import numpy as np

from rmrc.config.base import Direction, Frame, NonNegative, Vector3
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


class LookAtTask(HardTask, GainedTask):
    """Point an axis of a frame at a point in the world; the roll about the axis stays free."""

    target_kind: ClassVar[TargetKind] = "point"

    type: Literal["look_at"] = "look_at"
    B: NonNegative = 1.0
    """Weight of the squared difference of the two unit vectors, a number."""
    frame: Frame
    """The frame that looks."""
    axis: Direction = (0.0, 0.0, 1.0)
    """The axis that points, in the frame's own coordinates."""
    target: Vector3 | None = None
    """The point to look at in m; by default the point 1 m along the axis at the start."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "LookAtTerm":
        """Resolve the frame."""
        handle = resolve(model, self.frame)
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        ahead = mink.SE3(handle.pose_at(model, start)).apply(axis)
        return LookAtTerm(
            name=self.name,
            type=self.type,
            level=self.level,
            hard=self.hard,
            gain=gain_value(self.gain),
            weight=weight_array(self.B, 3),
            target=ahead if self.target is None else np.array(self.target),
            frame=handle,
            axis=axis,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class LookAtTerm(MinkTerm):
    """Rows of a `look_at` task, by mink's LookAtTask: e = d̂ − a for the target's direction d̂."""

    target_kind: ClassVar[TargetKind] = "point"
    decisive: ClassVar[bool] = True

    frame: FrameHandle
    axis: Array

    @property
    def units(self) -> tuple[str, ...]:
        """The angle."""
        return ("rad",)

    def measure(self, error: Array) -> Array:
        """Return the angle in rad between the axis and the target's direction."""
        return look_at_units(error)

    def attainable(self, error: Array, rate: Array) -> Array:
        """Return the part of ẋ that turns the axis."""
        return tangential(self.axis, error, rate)

    def task(self) -> mink.LookAtTask:
        """Return mink's task with unit cost and gain."""
        return mink.LookAtTask(self.frame.id, self.frame.kind, self.axis)

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target point."""
        assert isinstance(task, mink.LookAtTask)
        task.set_target(target)

    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return (I − d̂ d̂ᵀ) Rᵀ ṗ* / n for the target's velocity ṗ* and its distance n."""
        pose = configuration.get_transform_frame_to_world(self.frame.id, self.frame.kind)
        rotation = pose.rotation().as_matrix()
        toward = rotation.T @ (target - pose.translation())
        distance = max(float(np.linalg.norm(toward)), 1e-9)
        direction = toward / distance
        velocity = rotation.T @ twist[:3]
        return (velocity - direction * (direction @ velocity)) / distance
