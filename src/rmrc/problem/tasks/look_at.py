"""The `look_at` task: an axis of a frame points at a target point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mink
import mujoco
import numpy as np

from rmrc.config.base import Vector3
from rmrc.problem.tasks.base import Array, Pull, TargetKind
from rmrc.problem.tasks.pointing import PointingTask, PointingTerm

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
    """Rows of a `look_at` task, by mink's LookAtTask: e = d̂ − a for the target's direction d̂."""

    target_kind: ClassVar[TargetKind] = "point"

    def task(self) -> mink.LookAtTask:
        """Return mink's task with unit cost and gain."""
        return mink.LookAtTask(self.frame.id, self.frame.kind, self.axis)

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target point."""
        assert isinstance(task, mink.LookAtTask)
        task.set_target(target)

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return (I − d̂ d̂ᵀ) R pulled / n on the frame's origin and the torque d̂ × R pulled."""
        position, matrix = self.frame.views(evaluation.data)
        turned = matrix.reshape(3, 3) @ pulled
        away = evaluation.target[self.name] - position
        distance = max(float(np.linalg.norm(away)), LEAST_DISTANCE)
        direction = away / distance
        force = (turned - direction * (direction @ turned)) / distance
        velocities = self.frame.velocities(evaluation.model, evaluation.data)
        return Pull(*velocities, force, np.cross(direction, turned), distance)

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

    def carry(
        self, configuration: mink.Configuration, target: Array, twists: Sequence[Array]
    ) -> Array:
        """Return d̂ × ω − (I − d̂ d̂ᵀ) v / n for the frame's own velocity v and ω."""
        pose = configuration.get_transform_frame_to_world(self.frame.id, self.frame.kind)
        toward = pose.inverse().apply(target)
        distance = max(float(np.linalg.norm(toward)), 1e-9)
        direction, velocity = toward / distance, twists[0][:3]
        across = velocity - direction * (direction @ velocity)
        return np.cross(direction, twists[0][3:]) - across / distance
