"""The motions that paths are made of: straight or round in position, one turn in orientation.

Each is a function of s, the share of the motion that is done (0 ≤ s ≤ 1), and of its rate ds/dt.
Vectors and quaternions (wxyz, of unit norm) are tuples: at this size plain floats are several
times faster than arrays, and a path is sampled in every control step.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rmrc.text.base import Pose

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Below this many metres for each radian that it turns, a motion's length is counted in radians.
TURNING_ON_THE_SPOT = 1e-3


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the product of two quaternions: the rotation q, then p."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    w, x, y, z = q
    return (w, -x, -y, -z)


class Transform(NamedTuple):
    """A place of a frame in the world: its origin (m) and its orientation."""

    position: Vector
    quaternion: Quaternion

    @classmethod
    def from_array(cls, pose: NDArray[np.float64]) -> "Transform":
        """Return the transform of a pose (7,): xyz and wxyz."""
        x, y, z, *quaternion = pose.tolist()
        return cls((x, y, z), (quaternion[0], quaternion[1], quaternion[2], quaternion[3]))

    def direction(self, vector: Vector) -> Vector:
        """Return in world axes a vector given in this frame's axes."""
        q = self.quaternion
        return multiply(multiply(q, (0.0, *vector)), conjugate(q))[1:]

    def point(self, point: Vector) -> Vector:
        """Return in the world a point given in this frame."""
        (x, y, z), (a, b, c) = self.position, self.direction(point)
        return (x + a, y + b, z + c)

    def place(self, pose: Pose, before: "Transform") -> "Transform":
        """Return in the world a pose given in this frame; what it leaves out stays as `before`."""
        return Transform(
            before.position if pose.position is None else self.point(pose.position),
            before.quaternion
            if pose.quaternion is None
            else multiply(self.quaternion, pose.quaternion),
        )


IDENTITY = Transform((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class Straight:
    """A straight line: p(s) = p₀ + s·d."""

    start: Vector
    """p₀, in m."""
    displacement: Vector
    """d, in m."""

    @property
    def length(self) -> float:
        """Length, in m."""
        return math.hypot(*self.displacement)

    def at(
        self, s: float, rate: float, pose: NDArray[np.float64], twist: NDArray[np.float64]
    ) -> None:
        """Write the position into pose[:3] and the linear velocity into twist[:3]."""
        x, y, z = self.start
        a, b, c = self.displacement
        pose[0] = x + s * a
        pose[1] = y + s * b
        pose[2] = z + s * c
        twist[0] = rate * a
        twist[1] = rate * b
        twist[2] = rate * c


@dataclass(frozen=True, slots=True)
class Round:
    """A piece of a circle: p(s) = p₀ + (cos φ − 1)·r + sin φ·t, with φ = s·angle."""

    start: Vector
    """p₀, in m."""
    radius: Vector
    """r, from the centre to p₀, in m."""
    tangent: Vector
    """t = n × r for the unit axis n, in m."""
    angle: float
    """Angle turned about n, in rad."""

    @classmethod
    def about(
        cls,
        start: Vector,
        center: NDArray[np.float64],
        axis: NDArray[np.float64],
        angle: float,
    ) -> "Round":
        """Return the motion of a point that turns by an angle about a unit axis through a point."""
        radius = np.subtract(start, center)
        radius -= (radius @ axis) * axis
        a, b, c = radius.tolist()
        x, y, z = np.cross(axis, radius).tolist()
        return cls(start, (a, b, c), (x, y, z), angle)

    @property
    def length(self) -> float:
        """Length, in m."""
        return abs(self.angle) * math.hypot(*self.radius)

    def at(
        self, s: float, rate: float, pose: NDArray[np.float64], twist: NDArray[np.float64]
    ) -> None:
        """Write the position into pose[:3] and the linear velocity into twist[:3]."""
        x, y, z = self.start
        a, b, c = self.radius
        d, e, f = self.tangent
        sine, cosine = math.sin(s * self.angle), math.cos(s * self.angle)
        # cos φ − 1 = −2 sin²(φ/2), which does not cancel on a short piece of a large circle.
        back = -2.0 * math.sin(0.5 * s * self.angle) ** 2
        pose[0] = x + back * a + sine * d
        pose[1] = y + back * b + sine * e
        pose[2] = z + back * c + sine * f
        speed = rate * self.angle
        twist[0] = speed * (cosine * d - sine * a)
        twist[1] = speed * (cosine * e - sine * b)
        twist[2] = speed * (cosine * f - sine * c)


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn about a fixed axis of the world: R(s) = exp(s·angle·[u]×) R₀.

    Source: Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985 (slerp, written with
    the exponential).
    """

    start: Quaternion
    """R₀."""
    axis: Vector
    """u, of unit length in world axes; zero where nothing turns."""
    angle: float
    """Angle turned about u, in rad."""

    @classmethod
    def between(cls, start: Quaternion, end: Quaternion) -> "Turn":
        """Return the shortest turn between two orientations, whatever the signs of the quaternions.

        At exactly half a turn both ways are as short: the axis whose first non-zero component is
        positive is taken.
        """
        difference = multiply(end, conjugate(start))
        if difference < (0.0, 0.0, 0.0, 0.0):
            difference = (-difference[0], -difference[1], -difference[2], -difference[3])
        w, x, y, z = difference
        norm = math.hypot(x, y, z)
        if norm == 0.0:
            return cls(start, (0.0, 0.0, 0.0), 0.0)
        return cls(start, (x / norm, y / norm, z / norm), 2.0 * math.atan2(norm, w))

    def at(
        self, s: float, rate: float, pose: NDArray[np.float64], twist: NDArray[np.float64]
    ) -> None:
        """Write the quaternion into pose[3:] and the angular velocity into twist[3:]."""
        x, y, z = self.axis
        half = 0.5 * s * self.angle
        sine = math.sin(half)
        pose[3], pose[4], pose[5], pose[6] = multiply(
            (math.cos(half), sine * x, sine * y, sine * z), self.start
        )
        speed = rate * self.angle
        twist[3] = speed * x
        twist[4] = speed * y
        twist[5] = speed * z


@dataclass(frozen=True, slots=True)
class Segment:
    """A motion on SE(3): a line or a circle in position, and a turn at the same share s."""

    curve: Straight | Round
    turn: Turn

    @classmethod
    def between(cls, start: Transform, end: Transform) -> "Segment":
        """Return the straight line from one place to another, with the shortest turn."""
        (x, y, z), (a, b, c) = start.position, end.position
        curve = Straight(start.position, (a - x, b - y, c - z))
        return cls(curve, Turn.between(start.quaternion, end.quaternion))

    @property
    def length(self) -> float:
        """Length in m, or in rad where the frame only turns (less than 1 mm for each radian)."""
        metres, radians = self.curve.length, abs(self.turn.angle)
        return metres if metres > TURNING_ON_THE_SPOT * radians else radians

    def at(
        self, s: float, rate: float, pose: NDArray[np.float64], twist: NDArray[np.float64]
    ) -> None:
        """Write the pose (7,) at the share s, and the twist (6,) at the rate ds/dt in 1/s."""
        self.curve.at(s, rate, pose, twist)
        self.turn.at(s, rate, pose, twist)


def through(places: Iterable[Transform]) -> list[Segment]:
    """Return the segments that lead from each place to the next."""
    return [Segment.between(start, end) for start, end in pairwise(places)]
