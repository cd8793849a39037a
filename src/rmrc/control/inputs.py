"""What comes in at run time: taken if it is valid, refused, and nothing changed, if it is not."""

import math
from struct import Struct
from struct import error as StructError
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmrc.problem.configuration import QPOS_WIDTH, joint_type
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.tasks.base import Term

Array = NDArray[np.float64]

ZERO_NORM = 1e-12
"""A quaternion or a direction shorter than this has no direction."""
LARGEST = 1e12
"""A coordinate beyond this, m or rad, is no measurement and no target."""

# What a kind of target is not made of: indices of position, quaternion, velocity, q, direction.
_FOREIGN = {
    "pose": (3, 4),
    "point": (1, 3, 4),
    "direction": (0, 1, 3),
    "configuration": (0, 1, 2, 4),
    "rates": (0, 1, 3, 4),
    "none": (0, 1, 2, 3, 4),
}


# A struct writes a few numbers into an array in half the time of an assignment.
_POSE, _POINT = Struct("7d"), Struct("3d")


def sane(array: Array) -> bool:
    """Return whether all numbers are finite and of a size whose squares do not overflow."""
    return bool(np.maximum.reduce(np.absolute(array), axis=None) < LARGEST)  # NaN is not less


class Configurations:
    """Reads configurations (nq,) of one model."""

    def __init__(self, model: mujoco.MjModel):
        self.size = int(model.nq)
        self._quaternions = [
            int(model.jnt_qposadr[joint]) + width - 4
            for joint in range(model.njnt)
            if (width := QPOS_WIDTH[joint_type(model, joint)]) > 1
        ]

    def read(self, q: object) -> Array | None:
        """Return q as a new array (nq,) with unit quaternions, or None if it is not valid."""
        try:
            array = np.array(q)
        except (TypeError, ValueError, OverflowError):
            return None
        if array.dtype.kind not in "fiu" or array.shape != (self.size,):
            return None
        array = array.astype(float, copy=False)
        if not sane(array):
            return None
        for first in self._quaternions:
            quaternion = array[first : first + 4]
            norm = math.sqrt(quaternion.dot(quaternion))
            if norm < ZERO_NORM:
                return None
            quaternion /= norm
        return array


class Targets:
    """Writes targets into an `Evaluation`."""

    def __init__(self, evaluation: Evaluation, configurations: Configurations):
        self._evaluation = evaluation
        self._configurations = configurations

    def take(
        self,
        term: Term,
        position: Any,
        quaternion: Any,
        velocity: ArrayLike | None,
        q: ArrayLike | None,
        direction: ArrayLike | None,
    ) -> bool:
        """Write a target if all of it is valid; return whether it was."""
        kind, name = term.target_kind, term.name
        try:
            if kind == "pose" and q is None and direction is None:
                return self._take_pose(name, position, quaternion, velocity)
            given = (position, quaternion, velocity, q, direction)
            if any(given[k] is not None for k in _FOREIGN[kind]):
                return False
            if kind == "point" and position is not None:
                return self._take_point(name, position, velocity)
            if kind == "rates":
                return self._write(name, velocity)
            if kind == "configuration":
                return self._write(name, self._configurations.read(q))
            if kind == "direction":
                axis = np.asarray(direction, dtype=float)
                length = math.sqrt(axis.dot(axis)) if axis.shape == (3,) and sane(axis) else 0.0
                return length > ZERO_NORM and self._write(
                    name, axis / length, velocity, slice(3, 6)
                )
            return False
        except (
            TypeError,
            ValueError,
            OverflowError,
            StructError,
        ):  # not numbers, or of another shape
            return False

    def _write(
        self,
        name: str,
        value: ArrayLike | None,
        velocity: ArrayLike | None = None,
        part: slice = slice(0),
    ) -> bool:
        """Write a whole target, and its velocity as a part of its twist."""
        evaluation = self._evaluation
        target, new = evaluation.target[name], np.asarray(value, dtype=float)
        if new.shape != target.shape or not sane(new):
            return False
        if velocity is None or part == slice(0):
            evaluation.stop(name)
        else:
            moving = np.asarray(velocity, dtype=float)
            if moving.shape != (3,) or not sane(moving):
                return False
            evaluation.twist[name][part] = moving
            evaluation.moving.add(name)
        target[:] = new
        return True

    def _take_point(self, name: str, position: Any, velocity: ArrayLike | None) -> bool:
        if velocity is not None:
            return self._write(name, position, velocity, slice(3))
        a, b, c = position.tolist() if type(position) is np.ndarray else position
        if not a * a + b * b + c * c < LARGEST**2:  # NaN is not less
            return False
        _POINT.pack_into(self._evaluation.target[name], 0, a, b, c)  # pyright: ignore
        self._evaluation.stop(name)
        return True

    def _take_pose(
        self,
        name: str,
        position: Any,
        quaternion: Any,
        velocity: ArrayLike | None,
    ) -> bool:
        """Write a pose; on seven numbers plain floats are faster than arrays."""
        evaluation = self._evaluation
        target, k = evaluation.target[name], 1.0
        w, x, y, z, a, b, c = target.tolist()
        if position is not None:
            a, b, c = position.tolist() if type(position) is np.ndarray else position
            if not a * a + b * b + c * c < LARGEST**2:  # NaN is not less
                return False
        if quaternion is not None:
            w, x, y, z = quaternion.tolist() if type(quaternion) is np.ndarray else quaternion
            square = w * w + x * x + y * y + z * z
            if not ZERO_NORM**2 < square < LARGEST**2:
                return False
            k = 1.0 / math.sqrt(square)
        if velocity is None:
            evaluation.stop(name)
        else:
            twist = np.asarray(velocity, dtype=float)
            if twist.shape != (6,) or not sane(twist):
                return False
            evaluation.twist[name][:] = twist
            evaluation.moving.add(name)
        _POSE.pack_into(target, 0, w * k, x * k, y * k, z * k, a, b, c)  # pyright: ignore
        return True
