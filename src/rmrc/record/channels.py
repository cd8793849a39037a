"""The joints' coordinates as scalars over time, each with its name, unit and limits."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_AXES = ("x", "y", "z")
Rate = Literal["velocity", "acceleration", "jerk"]
_PER_SECOND: dict[Rate, str] = {"velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}


@dataclass(frozen=True, eq=False)
class Channel:
    """One scalar of the run, values (N,), with the limits it should stay inside (±∞: none)."""

    name: str
    unit: str
    values: Array
    lower: float
    upper: float
    dof: int
    """Which degree of freedom it is of, of an angle of several the first."""

    @property
    def excess(self) -> Array:
        """How far the values are outside their limits (N,), 0 inside."""
        return np.maximum(0.0, np.maximum(self.lower - self.values, self.values - self.upper))

    @property
    def bounded(self) -> bool:
        """Whether both limits are there, so that the values are a share of a range."""
        return bool(np.isfinite(self.upper - self.lower)) and self.upper > self.lower


def positions(model: dict[str, Any], q: Array) -> list[Channel]:
    """Return the positions of the robot's joints.

    A hinge or slide is its coordinate, a ball its rotation angle in [0, π], a free joint
    x, y, z and its rotation angle.

    Args:
        model: The manifest's `model`.
        q: Configurations (N, nq).
    """
    channels = []
    for joint in model["joints"]:
        first, lower, upper = joint["qpos"], *(joint["range"] or (-np.inf, np.inf))
        name, dof = joint["name"], joint["dof"]
        if joint["type"] == "ball":
            angle = _rotation_angle(q[:, first : first + 4])
            channels.append(Channel(f"{name} angle", "rad", angle, -upper, upper, dof))
        elif joint["type"] == "free":
            channels += [
                Channel(f"{name} {axis}", "m", q[:, first + i], -np.inf, np.inf, dof + i)
                for i, axis in enumerate(_AXES)
            ]
            angle = _rotation_angle(q[:, first + 3 : first + 7])
            channels.append(Channel(f"{name} angle", "rad", angle, -np.inf, np.inf, dof + 3))
        else:
            channels.append(Channel(name, joint["unit"], q[:, first], lower, upper, dof))
    return channels


def rates(model: dict[str, Any], values: Array, bound: Rate) -> list[Channel]:
    """Return the velocities, accelerations or jerks of the robot's degrees of freedom, in order.

    Args:
        model: The manifest's `model`; a joint's `velocity`, `acceleration` or `jerk` is its
            largest rate, null where there is none; a free joint's may be a pair, of its linear
            and its angular part.
        values: Velocities, accelerations or jerks (N, nv).
        bound: Which of them.
    """
    channels = []
    for joint in model["joints"]:
        per_second, first = _PER_SECOND[bound], joint["dof"]
        largest = joint.get(bound) or np.inf
        if joint["type"] == "ball":
            parts = [(f" r{axis}", "rad", largest) for axis in _AXES]
        elif joint["type"] == "free":
            linear, angular = largest if isinstance(largest, list) else (largest, largest)
            parts = [(f" {axis}", "m", linear or np.inf) for axis in _AXES]
            parts += [(f" r{axis}", "rad", angular or np.inf) for axis in _AXES]
        else:
            parts = [("", joint["unit"], largest)]
        channels += [
            Channel(
                joint["name"] + part, unit + per_second, values[:, first + i], -cap, cap, first + i
            )
            for i, (part, unit, cap) in enumerate(parts)
        ]
    return channels


def _rotation_angle(quaternions: Array) -> Array:
    """Return the angles (N,) of rotations given as quaternions wxyz (N, 4)."""
    return 2.0 * np.arctan2(np.linalg.norm(quaternions[:, 1:], axis=1), np.abs(quaternions[:, 0]))
