"""What every path shares: the base classes of its configuration, and the trajectory it builds."""

import math
import pathlib
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from rmrc.errors import ConfigError
from rmrc.paths.geometry import IDENTITY, Segment, Transform
from rmrc.paths.profiles import PROFILES, ProfileName
from rmrc.text.base import Model, NonNegative, Positive

# The reciprocal of a shorter time, in s, would overflow.
LEAST_SPAN = 1e-300


class Trajectory:
    """Where a target is and how fast it moves at every time: segments, one after another."""

    def __init__(
        self,
        segments: Sequence[Segment],
        times: Sequence[float],
        profile: ProfileName = "constant",
    ) -> None:
        """Run segments[k] from times[k] to times[k + 1] (s), each with the profile.

        Raises ConfigError where lengths or times overflow.
        """
        extent = sum(segment.length for segment in segments) + times[-1]
        if not math.isfinite(extent) or any(0.0 < b - a < LEAST_SPAN for a, b in pairwise(times)):
            raise ConfigError("the path's lengths or times are too large or too small to compute")
        self._segments = segments
        self._times = times
        self._profile = PROFILES[profile].at

    @property
    def duration(self) -> float:
        """Time from the start of the run until the target stands still, in s."""
        return self._times[-1]

    def sample(self, time: float, pose: NDArray[np.float64], twist: NDArray[np.float64]) -> None:
        """Write the target's pose and twist in the world at a time from the start of the run, in s.

        `pose` (7,) receives xyz and wxyz; `twist` (6,) the linear velocity of the frame's origin
        (m/s), then the angular velocity (rad/s), both in world axes. Before the motion begins and
        from its end on, the pose is that of the beginning and of the end, and the twist is zero.
        """
        times = self._times
        if time < times[0]:
            self._segments[0].at(0.0, 0.0, pose, twist)
        elif time >= times[-1]:
            self._segments[-1].at(1.0, 0.0, pose, twist)
        else:
            k = bisect_right(times, time) - 1
            span = times[k + 1] - times[k]
            s, rate = self._profile((time - times[k]) / span)
            self._segments[k].at(s, rate / span, pose, twist)


class PathModel(Model, ABC):
    """Where a target is at each time, and how fast it moves."""

    @abstractmethod
    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory of a target that has the pose `start` when the run starts.

        `start` (7,) is xyz and a unit quaternion wxyz, in the world; a target without an
        orientation gives the identity. `root` is the folder that files are relative to.

        Raises ConfigError where the path does not exist from there.
        """


class MovingPath(PathModel):
    """A path that leaves the start."""

    coordinates: Literal["world", "start"] = "world"
    """Frame that positions, directions and quaternions are in: the world, or the target's own
    frame at the start of the run."""
    delay: NonNegative = 0.0
    """Time before the motion begins, in s."""

    def frame(self, start: Transform) -> Transform:
        """Return the frame of the coordinates."""
        return start if self.coordinates == "start" else IDENTITY


class TimedPath(MovingPath):
    """A path with a profile of speed, and either a duration or a speed."""

    profile: ProfileName = "minimum_jerk"
    """How the speed changes along the path: constant, trapezoid (a quarter of the time speeding up,
    a quarter slowing down) or minimum_jerk."""
    duration: Positive | None = None
    """Time of the motion, in s; this or `speed`."""
    speed: Positive | None = None
    """Largest speed, in m/s, or in rad/s where the target only turns; this or `duration`."""

    @model_validator(mode="after")
    def _duration_or_speed(self) -> "TimedPath":
        if (self.duration is None) == (self.speed is None):
            raise ValueError("give exactly one of duration (s) and speed (m/s)")
        return self

    def timed(self, segments: Sequence[Segment]) -> Trajectory:
        """Return the trajectory along the segments, each taking time in proportion to its length.

        A segment of length L takes L·peak/speed, where peak is the profile's largest ds/dτ.
        """
        lengths = [segment.length for segment in segments]
        total = sum(lengths)
        if self.speed is not None:
            duration = total * PROFILES[self.profile].peak / self.speed
        else:
            assert self.duration is not None  # held by the validator
            duration = self.duration
        shares = [length / total if total else 1.0 / len(lengths) for length in lengths]
        times = list(accumulate((duration * share for share in shares), initial=self.delay))
        return Trajectory(segments, times, self.profile)
