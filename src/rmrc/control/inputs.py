"""What comes in at run time: taken if it is valid, refused, and nothing changed, if it is not."""

import math
from collections.abc import Mapping
from struct import Struct
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmrc.model.configuration import QPOS_WIDTH, joint_type
from rmrc.problem.evaluation import Evaluation
from rmrc.tasks.base import Term

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
_FLOAT = np.dtype(float)  # there is one of it


def sane(array: Array) -> bool:
    """Return whether all numbers are finite and of a size whose squares do not overflow."""
    return bool(np.maximum.reduce(np.absolute(array), axis=None) < LARGEST)  # NaN is not less


def numbers(value: Any, *shape: int) -> Array | None:
    """Return real numbers of a shape as floats, not copied if they are; None if value is none."""
    if type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == shape:
        return value
    try:
        array = np.asarray(value)
    except Exception:  # arrays of other libraries raise what they like, as PyTorch's on a GPU
        return None
    if array.dtype.kind not in "fiu" or array.shape != shape:
        return None
    if array.dtype != float:
        with np.errstate(over="ignore"):  # a longer float may be beyond all floats
            return array.astype(float)
    return array


def counted_from(rate: Array, before: Array, command: Array) -> Array:
    """Return the velocity (nv,) that accelerations count from where v is measured.

    It is the measured one, but of a joint that the last command slowed down already: there it is
    the last command, or rest where that has another sign. A drive that lags follows a command that
    stays a·dt below what is measured with a·dt/lag alone, and passes its limit.

    Args:
        rate: The measured velocity (nv,).
        before: That of the step before.
        command: The last command (nv,).
    """
    ahead = np.sign(rate)
    slows = (ahead * before > 0.0) & (ahead * command < ahead * before)
    return np.where(slows, ahead * np.clip(ahead * command, 0.0, np.abs(rate)), rate)


def fault(name: str, value: Any, *shape: int) -> str | None:
    """Return what is wrong with real numbers of a shape, as "q[2] is nan"; None if nothing is."""
    array = numbers(value, *shape)
    if array is None:
        try:
            found = np.asarray(value)
        except Exception:  # as in `numbers`
            return f"{name} is no array of numbers, but {_kind(value)}"
        if found.dtype.kind not in "fiu":
            return f"{name} is no array of numbers, but {_kind(value)}"
        return f"{name} has the shape {found.shape}, and not {shape}"
    wrong = np.argwhere(~(np.absolute(array) < LARGEST))  # NaN is not less
    if not wrong.size:
        return None
    at, number = wrong[0].tolist(), array[tuple(wrong[0])]
    what = f"{name}{at or ''} is {number:.4g}"
    return what if not np.isfinite(number) else f"{what}, and no number is beyond {LARGEST:g}"


def _kind(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"


def _of_no_length(name: str, value: Any, *shape: int) -> str | None:
    """Return what is wrong with a quaternion or a direction."""
    return fault(name, value, *shape) or f"{name} is zero, and has no direction"


class Configurations:
    """Reads configurations (nq,) of one model."""

    def __init__(self, model: mujoco.MjModel):
        self.size, self.rates = int(model.nq), int(model.nv)
        self.quaternions = [
            int(model.jnt_qposadr[joint]) + width - 4
            for joint in range(model.njnt)
            if (width := QPOS_WIDTH[joint_type(model, joint)]) > 1
        ]
        """Where the quaternions stand."""

    def read(self, q: object) -> Array | None:
        """Return q as a new array (nq,) with unit quaternions, or None if it is not valid."""
        given = numbers(q, self.size)
        if given is None or not sane(given):
            return None
        array = np.array(given)
        for first in self.quaternions:
            quaternion = array[first : first + 4]
            # One by one, as the extension does: a sum of numpy's has another order.
            w, x, y, z = quaternion.tolist()
            norm = math.sqrt(w * w + x * x + y * y + z * z)
            if norm < ZERO_NORM:
                return None
            quaternion /= norm
        return array

    def fault(self, name: str, q: object) -> str:
        """Return what is wrong with a q that was not read."""
        return fault(name, q, self.size) or f"{name} has a quaternion that is zero"

    def velocity_fault(self, name: str, v: object) -> str:
        """Return what is wrong with a v that was not read."""
        return fault(name, v, self.rates) or f"{name} is not valid"

    def read_velocity(self, v: object) -> Array | None:
        """Return v as a new array (nv,), or None if it is not valid."""
        given = numbers(v, self.rates)
        return np.array(given) if given is not None and sane(given) else None


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
        if kind == "pose" and q is None and direction is None:
            return self._take_pose(name, position, quaternion, velocity)
        given = (position, quaternion, velocity, q, direction)
        if any(given[k] is not None for k in _FOREIGN[kind]):
            return False
        if kind == "point" and position is not None:
            return self._take_point(name, position, velocity)
        if kind == "rates":
            return self._write(name, self._configurations.read_velocity(velocity))
        if kind == "configuration":
            return self._write(name, self._configurations.read(q))
        if kind == "direction":
            axis = numbers(direction, 3)
            if axis is None or not sane(axis):
                return False
            length = math.sqrt(axis.dot(axis))
            return length > ZERO_NORM and self._write(name, axis / length, velocity, slice(3, 6))
        return False

    def fault(
        self, term: Term, position: Any, quaternion: Any, velocity: Any, q: Any, direction: Any
    ) -> str:
        """Return what is wrong with a target that was not taken."""
        kind, read = term.target_kind, self._configurations
        names = ("position", "quaternion", "velocity", "q", "direction")
        given: dict[str, Any] = dict(
            zip(names, (position, quaternion, velocity, q, direction), strict=True)
        )
        foreign = [names[k] for k in _FOREIGN[kind] if given[names[k]] is not None]
        needed: dict[str, str] = {"point": "position", "rates": "velocity", "configuration": "q"}
        needed["direction"] = "direction"
        if foreign:
            what = f"it takes no {foreign[0]}"
        elif kind in needed and given[needed[kind]] is None:
            what = f"it needs a {needed[kind]}"
        elif kind == "configuration":
            what = read.fault("q", q)
        elif kind == "rates":
            what = read.velocity_fault("velocity", velocity)
        else:
            width = 6 if kind == "pose" else 3
            what = (
                (position is not None and fault("position", position, 3))
                or (velocity is not None and fault("velocity", velocity, width))
                or (quaternion is not None and _of_no_length("quaternion", quaternion, 4))
                or (direction is not None and _of_no_length("direction", direction, 3))
                or "it is not valid"
            )
        return f"target of {term.name}: {what}; the last good one stays"

    def _write(
        self, name: str, value: Array | None, velocity: Any = None, part: slice = slice(0)
    ) -> bool:
        """Write a whole target, and its velocity as a part of its twist."""
        if value is None or not self._move(name, velocity, part):
            return False
        self._evaluation.target[name][:] = value
        return True

    def _move(self, name: str, velocity: Any, part: slice) -> bool:
        """Write a target's velocity as a part of its twist; without one it rests."""
        evaluation = self._evaluation
        if velocity is None:
            evaluation.stop(name)
            return True
        twist = numbers(velocity, part.stop - part.start)
        if twist is None or not sane(twist):
            return False
        evaluation.twist[name][part] = twist
        evaluation.moving[evaluation.index[name]] = 1
        return True

    def _take_point(self, name: str, position: Any, velocity: Any) -> bool:
        point = numbers(position, 3)
        if point is None:
            return False
        a, b, c = point.tolist()
        if not a * a + b * b + c * c < LARGEST**2:  # NaN is not less
            return False
        if not self._move(name, velocity, slice(0, 3)):
            return False
        _POINT.pack_into(self._evaluation.target[name], 0, a, b, c)  # pyright: ignore
        return True

    def _take_pose(self, name: str, position: Any, quaternion: Any, velocity: Any) -> bool:
        """Write a pose; on seven numbers plain floats are faster than arrays."""
        target, k = self._evaluation.target[name], 1.0
        w, x, y, z, a, b, c = target.tolist()
        if position is not None:
            point = numbers(position, 3)
            if point is None:
                return False
            a, b, c = point.tolist()
            if not a * a + b * b + c * c < LARGEST**2:  # NaN is not less
                return False
        if quaternion is not None:
            turn = numbers(quaternion, 4)
            if turn is None:
                return False
            w, x, y, z = turn.tolist()
            square = w * w + x * x + y * y + z * z
            if not ZERO_NORM**2 < square < LARGEST**2:
                return False
            k = 1.0 / math.sqrt(square)
        if not self._move(name, velocity, slice(0, 6)):
            return False
        _POSE.pack_into(target, 0, w * k, x * k, y * k, z * k, a, b, c)  # pyright: ignore
        return True

    @staticmethod
    def pose_fault(name: str, position: Any, quaternion: Any, velocity: Any) -> str:
        """Return what is wrong with an obstacle's pose that was not taken."""
        what = (
            (position is not None and fault("position", position, 3))
            or (velocity is not None and fault("velocity", velocity, 6))
            or (quaternion is not None and _of_no_length("quaternion", quaternion, 4))
            or "it is not valid"
        )
        return f"obstacle {name}: {what}; it stays where it was"

    @staticmethod
    def pose(
        position: Array,
        quaternion: Array,
        new_position: ArrayLike | None,
        new_quaternion: ArrayLike | None,
        velocity: ArrayLike | None,
    ) -> Array | None:
        """Return a pose and its twist (13,), xyz, wxyz, linear, angular; None if it is not valid.

        Without a new position or quaternion they are the present ones, without a velocity 0.
        """
        place = position if new_position is None else numbers(new_position, 3)
        turn = quaternion if new_quaternion is None else numbers(new_quaternion, 4)
        twist = np.zeros(6) if velocity is None else numbers(velocity, 6)
        if place is None or turn is None or twist is None:
            return None
        pose = np.concatenate([place, turn, twist])
        if not sane(pose) or not (norm := math.sqrt(turn.dot(turn))) >= ZERO_NORM:
            return None
        pose[3:7] /= norm
        return pose


def as_arguments(target: Any) -> dict[str, Any]:
    """Return a target as the arguments of `set_target`; what is no pose is left to it to refuse."""
    if isinstance(target, Mapping):
        return dict(target)
    try:
        pose = np.array(target, dtype=float)
    except (TypeError, ValueError):
        return {"position": target}
    if pose.shape == (7,):
        return {"position": pose[:3], "quaternion": pose[3:]}
    if pose.shape != (4, 4):
        return {"position": target}
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, pose[:3, :3].ravel())
    return {"position": pose[:3, 3], "quaternion": quaternion}
