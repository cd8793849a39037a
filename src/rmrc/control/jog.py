"""Jogging: frames that move by a twist, and stay where they were when it ends."""

from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.model.frames import FrameHandle
from rmrc.problem.problem import Problem

Array = NDArray[np.float64]

STOPPED = 1e-4
"""m/s and rad/s: a frame without a twist that is slower has stopped, and is held where it is."""


class Frames:
    """The frames of the tasks at any configuration, by MuJoCo, in a data of their own."""

    def __init__(self, problem: Problem, data: mujoco.MjData):
        self._model, self._source = problem.model, data
        self._frame = {
            term.name: frame
            for term in problem.terms
            if isinstance(frame := getattr(term, "frame", None), FrameHandle)
        }

    @cached_property
    def _data(self) -> mujoco.MjData:
        """Made when it is first asked for: most controllers never are."""
        return mujoco.MjData(self._model)

    def pose(self, name: str, q: Array) -> tuple[Array, Array]:
        """Return the position (3,) and the rotation (3, 3) of a task's frame at q (nq,)."""
        position, matrix = self._at(name, q).views(self._data)
        return position.copy(), matrix.reshape(3, 3).copy()

    def jacobian(self, name: str, q: Array) -> Array:
        """Return J (6, nv) of a task's frame at q (nq,), [linear; angular] in the world's axes."""
        return np.vstack(self._at(name, q).velocities(self._model, self._data))

    def _at(self, name: str, q: Array) -> FrameHandle:
        if name not in self._frame:
            raise ModelError(unknown_name("task with a frame", name, self._frame))
        data = self._data
        data.qpos = q
        data.mocap_pos, data.mocap_quat = self._source.mocap_pos, self._source.mocap_quat
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        return self._frame[name]


class Jog:
    """The twists of frames that are jogged.

    Their targets are where the frames are, and move by the twists: what holds a frame back holds
    its target, too, and nothing has to be caught up. A frame whose twist is zero is held where it
    stops.
    """

    def __init__(self, frames: Frames):
        self._frames, self._twists = frames, dict[str, Array]()

    @property
    def active(self) -> bool:
        """Whether any frame is jogged, or has not stopped yet."""
        return bool(self._twists)

    def among(self, frames: Frames) -> "Jog":
        """Return the same twists of other frames."""
        other = Jog(frames)
        other._twists = self._twists
        return other

    def set(self, name: str, twist: Array) -> None:
        """Have a frame move by a twist (6,), [linear; angular] in the world's axes."""
        self._twists[name] = twist

    def forget(self, name: str | None = None) -> None:
        """Leave a frame, or all of them, to their targets."""
        if name is None:
            self._twists.clear()
        else:
            self._twists.pop(name, None)

    def targets(self, q: Array, v: Array) -> list[tuple[str, Array, Array, Array]]:
        """Return name, position (3,), wxyz (4,) and twist (6,) of each target, at q and last v."""
        found = []
        for name, twist in list(self._twists.items()):
            position, rotation = self._frames.pose(name, q)
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, rotation.ravel())
            found.append((name, position, quaternion, twist))
            moving = np.abs(self._frames.jacobian(name, q) @ v).max()
            if not twist.any() and moving < STOPPED:
                del self._twists[name]
        return found
