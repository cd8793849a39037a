"""The path along a circular arc through three points."""

import math
import pathlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ConfigError
from rmrc.paths.base import TimedPath, Trajectory
from rmrc.paths.geometry import Round, Segment, Transform, Turn, Vector
from rmrc.text.base import Pose, Vector3

# Three points count as lying on one line where the sine of the angle at the first is smaller.
LEAST_SINE = 1e-6


class ArcPath(TimedPath):
    """The circular arc from the start through a point to a pose, turning the shortest way."""

    path: Literal["arc"] = "arc"
    via: Vector3
    """A point that the arc passes through: x, y, z in m."""
    to: Pose
    """Where the arc ends; an orientation that it leaves out stays as at the start."""

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory of the arc; see `PathModel.build`.

        Raises ConfigError where the three points lie on one line.
        """
        here = Transform.from_array(start)
        frame = self.frame(here)
        end = frame.place(self.to, here)
        curve = _through(here.position, frame.point(self.via), end.position)
        return self.timed([Segment(curve, Turn.between(here.quaternion, end.quaternion))])


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused in the end
def _through(start: Vector, via: Vector, end: Vector) -> Round:
    """Return the arc through three points.

    With a and b the vectors from the start to the other two points, and n = a × b, the centre is
    at c = (|a|² b − |b|² a) × n / (2 |n|²) from the start, and the arc turns about n.
    """
    a, b = np.subtract(via, start), np.subtract(end, start)
    normal = np.cross(a, b)
    area = math.hypot(*normal)
    if area <= LEAST_SINE * math.hypot(*a) * math.hypot(*b):
        points = ", ".join(f"[{x:.6g}, {y:.6g}, {z:.6g}]" for x, y, z in (start, via, end))
        raise ConfigError(
            "the start, via and to of an arc lie on one line, and no circle passes through them:"
            f" {points}"
        )
    axis = normal / area
    c = np.cross((a @ a) * b - (b @ b) * a, axis) / (2.0 * area)
    angle = math.atan2(axis @ np.cross(-c, b - c), -c @ (b - c)) % math.tau
    return Round.about(start, start + c, axis, angle)
