"""The `relative_frame` task: one frame keeps a pose relative to another that may move too."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mink
import mujoco

from rmrc.config.base import Frame
from rmrc.problem.frames import FrameHandle, resolve
from rmrc.problem.lie import adjoint, inverse, inverse_multiply, jlog, turn_back
from rmrc.problem.tasks.base import Array
from rmrc.problem.tasks.frame import PoseTask, PoseTerm
from rmrc.problem.tasks.mink_tasks import MinkTerm


class RelativeFrameTask(PoseTask):
    """Bring a frame to a target pose in the coordinates of another frame of the robot."""

    type: Literal["relative_frame"] = "relative_frame"
    frame: Frame
    """The frame that moves."""
    root: Frame
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

    e = −log(T_tf) and J = Jlog(T_tf) (J_f − Ad(T_fr) J_r), for the frame f, the root r and the
    target t in the root's coordinates.
    """

    frame: FrameHandle
    root: FrameHandle

    def task(self) -> mink.RelativeFrameTask:
        """Return mink's task with unit cost and gain."""
        return mink.RelativeFrameTask(
            self.frame.id, self.frame.kind, self.root.id, self.root.kind, 1.0, 1.0
        )

    def aim(self, task: mink.Task, target: Array) -> None:
        """Set the target pose."""
        assert isinstance(task, mink.RelativeFrameTask)
        task.set_target(mink.SE3(target))

    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return Jlog(T_tf) Ad(T_ft) V_t for the target's twist, turned into its own axes."""
        pose = configuration.get_transform(
            self.frame.id, self.frame.kind, self.root.id, self.root.kind
        )
        relative = inverse_multiply(target, pose.wxyz_xyz)
        return jlog(relative) @ (adjoint(inverse(relative)) @ turn_back(target, twist))

    @property
    def frames(self) -> tuple[FrameHandle, ...]:
        """The frame and its root."""
        return self.frame, self.root

    def carry(
        self, configuration: mink.Configuration, target: Array, twists: Sequence[Array]
    ) -> Array:
        """Return −Jlog(T_tf) (V_f − Ad(T_fr) V_r)."""
        pose = configuration.get_transform(
            self.frame.id, self.frame.kind, self.root.id, self.root.kind
        )
        of_frame, of_root = twists
        carried = of_frame - adjoint(inverse(pose.wxyz_xyz)) @ of_root
        return -jlog(inverse_multiply(target, pose.wxyz_xyz)) @ carried
