"""The `look_at` task: an axis of a frame points at a target point."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mink
import mujoco
import numpy as np

from rmrc.tasks.base import Array, Pull, TargetKind
from rmrc.tasks.pointing import PointingTask, PointingTerm
from rmrc.text.base import Vector3

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

LEAST_DISTANCE = 1e-10
"""A target nearer than this, m, has no direction; mink's own threshold."""


class LookAtTask(PointingTask):
    """Point an axis of a frame at a point in the world; the roll about the axis stays free."""

    target_kind: ClassVar[TargetKind] = "point"

    type: Literal["look_at"] = "look_at"
    target: Vector3 | None = None
    """The point to look at in m; by default the point 1 m along the axis at the start."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "LookAtTerm":
        """Resolve the frame."""
        fields, pose = self.pointing(model, start)
        ahead = pose.apply(fields["axis"])
        return LookAtTerm(**fields, target=ahead if self.target is None else np.array(self.target))


@dataclass(frozen=True, eq=False, kw_only=True)
class LookAtTerm(PointingTerm):
    """Rows of a `look_at` task, by mink's LookAtTask: d is the direction d̂ of the target."""

    target_kind: ClassVar[TargetKind] = "point"

    def task(self) -> mink.LookAtTask:
        """Return mink's task with unit cost and gain."""
        return mink.LookAtTask(self.frame.id, self.frame.kind, self.axis)

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target point."""
        assert isinstance(task, mink.LookAtTask)
        task.set_target(target)

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return the force (I − d̂ d̂ᵀ) R Mᵀ pulled / n and the torque d̂ × R Mᵀ pulled."""
        position, matrix = self.frame.views(evaluation.data)
        error = evaluation.error_of(evaluation.error, self)
        turned = matrix.reshape(3, 3) @ self.unstretched(pulled, error)
        away = evaluation.target[self.name] - position
        distance = max(float(np.linalg.norm(away)), LEAST_DISTANCE)
        direction = away / distance
        force = (turned - direction * (direction @ turned)) / distance
        velocities = self.frame.velocities(evaluation.model, evaluation.data)
        return Pull(*velocities, force, np.cross(direction, turned), distance)

    def turned(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return (I − d̂ d̂ᵀ) Rᵀ ṗ* / n for the target's velocity ṗ* and its distance n."""
        return self._across(pose, target, pose.rotation().as_matrix().T @ twist[:3])

    def carried(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return d̂ × ω − (I − d̂ d̂ᵀ) v / n for the frame's own velocity v and ω."""
        direction, _ = self._sight(pose, target)
        return np.cross(direction, twist[3:]) - self._across(pose, target, twist[:3])

    def _sight(self, pose: mink.SE3, target: Array) -> tuple[Array, float]:
        """Return d̂ (3,) and n."""
        toward = pose.inverse().apply(target)
        distance = max(float(np.linalg.norm(toward)), 1e-9)
        return toward / distance, distance

    def _across(self, pose: mink.SE3, target: Array, velocity: Array) -> Array:
        """Return (I − d̂ d̂ᵀ) v / n."""
        direction, distance = self._sight(pose, target)
        return (velocity - direction * (direction @ velocity)) / distance
