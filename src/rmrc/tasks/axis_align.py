"""The `axis_align` task: an axis of a frame points along a direction of the world."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mink
import mujoco
import numpy as np

from rmrc.tasks.base import Array, Pull, TargetKind
from rmrc.tasks.pointing import PointingTask, PointingTerm
from rmrc.text.base import Direction

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class AxisAlignTask(PointingTask):
    """Point an axis of a frame along a direction of the world; the roll about it stays free."""

    target_kind: ClassVar[TargetKind] = "direction"

    type: Literal["axis_align"] = "axis_align"
    target: Direction | None = None
    """The direction in the world; by default the axis' own at the start."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "AxisAlignTerm":
        """Resolve the frame."""
        fields, pose = self.pointing(model, start)
        own = pose.rotation().apply(fields["axis"])
        target = own if self.target is None else np.array(self.target)
        return AxisAlignTerm(**fields, target=target / np.linalg.norm(target))


@dataclass(frozen=True, eq=False, kw_only=True)
class AxisAlignTerm(PointingTerm):
    """Rows of an `axis_align` task, by mink's AxisAlignTask: d = Rᵀt."""

    target_kind: ClassVar[TargetKind] = "direction"

    def task(self) -> mink.AxisAlignTask:
        """Return mink's task with unit cost and gain."""
        return mink.AxisAlignTask(self.frame.id, self.frame.kind, self.axis)

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target direction."""
        assert isinstance(task, mink.AxisAlignTask)
        task.set_target(target)

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return the torque t × R Mᵀ pulled."""
        pulled = self.unstretched(pulled, evaluation.error_of(evaluation.error, self))
        turned = self.frame.views(evaluation.data)[1].reshape(3, 3) @ pulled
        velocities = self.frame.velocities(evaluation.model, evaluation.data)
        return Pull(*velocities, np.zeros(3), np.cross(evaluation.target[self.name], turned))

    def turned(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return Rᵀ (ω × t) for the direction's angular velocity ω, the twist's second half."""
        return pose.rotation().as_matrix().T @ np.cross(twist[3:], target)

    def carried(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return Rᵀt × ω for the frame's own angular velocity ω."""
        return np.cross(pose.rotation().as_matrix().T @ target, twist[3:])
