"""The `relative_frame` task: one frame keeps a pose relative to another that may move too."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import mink
import mujoco
import numpy as np

from rmrc.model.frames import FrameHandle, resolve
from rmrc.model.lie import (
    adjoint,
    inverse,
    inverse_left_jacobian,
    inverse_multiply,
    log_motion,
    turn_back,
)
from rmrc.tasks.base import Array, Pull, Way
from rmrc.tasks.frame import PoseTask, PoseTerm
from rmrc.tasks.mink_tasks import MinkTerm
from rmrc.text.base import FrameName

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class RelativeFrameTask(PoseTask):
    """Bring a frame to a target pose in the coordinates of another frame of the robot."""

    type: Literal["relative_frame"] = "relative_frame"
    frame: FrameName
    """The frame that moves."""
    root: FrameName
    """The frame in whose coordinates the target is given."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the body of the frame that moves."""
        return [resolve(model, self.frame).body(model)]

    def compile(self, model: mujoco.MjModel, start: Array) -> "RelativeFrameTerm":
        """Resolve both frames; the target is their relative pose at the start."""
        weight = self.pose_weight()
        frame, root = resolve(model, self.frame), resolve(model, self.root)
        return RelativeFrameTerm(
            **self.common(),
            weight=weight,
            target=inverse_multiply(root.pose_at(model, start), frame.pose_at(model, start)),
            frame=frame,
            root=root,
            clamp=(self.clamp.position or float("inf"), self.clamp.orientation or float("inf")),
            preserve=self.preserve is not None,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class RelativeFrameTerm(MinkTerm, PoseTerm):
    """Rows of a `relative_frame` task, by mink's RelativeFrameTask.

    e = −log(T_tf) and J = Jl⁻¹(e) (J_f − Ad(T_fr) J_r), for the frame f, the root r and the
    target t in the root's coordinates.
    """

    frame: FrameHandle
    root: FrameHandle

    def way(self, model: mujoco.MjModel) -> Way:
        """Return the dofs on the way from the root to the frame, without those that move both."""
        frame, root = self.frame.dofs(model), self.root.dofs(model)
        back = [dof for dof in reversed(root) if dof not in frame]
        return Way.chain(back + [dof for dof in frame if dof not in root])

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return the force and the torque at the frame's origin, against the root."""
        model, data = evaluation.model, evaluation.data
        rotation = self.frame.views(data)[1].reshape(3, 3)
        wrench = inverse_left_jacobian(evaluation.error_of(evaluation.error, self)).T @ pulled
        velocities = self._velocities(model, data)
        return Pull(*velocities, rotation @ wrench[:3], rotation @ wrench[3:])

    def task(self) -> mink.RelativeFrameTask:
        """Return mink's task with unit cost and gain."""
        return mink.RelativeFrameTask(
            self.frame.id, self.frame.kind, self.root.id, self.root.kind, 1.0, 1.0
        )

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target pose."""
        assert isinstance(task, mink.RelativeFrameTask)
        task.set_target(mink.SE3(target))

    def linearize(
        self, task: mink.Task, configuration: mink.Configuration, target: Array
    ) -> tuple[Array, Array]:
        """Return mink's J and e with a logarithm and a Jl⁻¹ that are exact near θ = 0, too."""
        model, data = configuration.model, configuration.data
        pose = self._pose(configuration)
        error = log_motion(inverse_multiply(pose, target))
        linear, angular = self._velocities(model, data)
        rotation = self.frame.views(data)[1].reshape(3, 3)
        along = np.vstack([rotation.T @ linear, rotation.T @ angular])
        return inverse_left_jacobian(error) @ along, error

    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return Jl⁻¹(e) Ad(T_ft) V_t for the target's twist, turned into its own axes."""
        relative = inverse_multiply(target, self._pose(configuration))
        own = adjoint(inverse(relative)) @ turn_back(target, twist)
        return inverse_left_jacobian(error) @ own

    @property
    def frames(self) -> tuple[FrameHandle, ...]:
        """The frame and its root."""
        return self.frame, self.root

    def carry(
        self,
        configuration: mink.Configuration,
        error: Array,
        target: Array,
        twists: Sequence[Array],
    ) -> Array:
        """Return −Jl⁻¹(e) (V_f − Ad(T_fr) V_r)."""
        of_frame, of_root = twists
        carried = of_frame - adjoint(inverse(self._pose(configuration))) @ of_root
        return -inverse_left_jacobian(error) @ carried

    def _pose(self, configuration: mink.Configuration) -> Array:
        """Return T_rf (7,), the frame in the coordinates of the root."""
        return configuration.get_transform(
            self.frame.id, self.frame.kind, self.root.id, self.root.kind
        ).wxyz_xyz

    def _velocities(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return how the dofs move the frame against the root (3, nv), in the world's axes."""
        linear, angular = self.frame.velocities(model, data)
        origin, turning = self.root.velocities(model, data)
        lever = self.frame.views(data)[0] - self.root.views(data)[0]
        return linear - origin - np.cross(turning.T, lever).T, angular - turning
