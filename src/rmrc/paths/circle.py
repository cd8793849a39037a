"""The path round a circle, as often as wanted."""

import math
import pathlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ConfigError
from rmrc.paths.base import TimedPath, Trajectory
from rmrc.paths.geometry import Round, Segment, Transform, Turn
from rmrc.text.base import Direction, Number, Vector3

# A start nearer to the axis than this, in m, is on the axis.
LEAST_RADIUS = 1e-9


class CirclePath(TimedPath):
    """The start turned about an axis, so that the start lies on the circle by construction."""

    path: Literal["circle"] = "circle"
    center: Vector3
    """A point on the axis, such as the circle's centre: x, y, z in m."""
    normal: Direction
    """Direction of the axis; positive turns go about it by the right-hand rule."""
    turns: Number = 1.0
    """How many times round; negative goes the other way."""
    orientation: Literal["fixed", "follow"] = "fixed"
    """Whether the orientation stays, or turns about the axis with the position."""

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory round the circle; see `PathModel.build`.

        Raises ConfigError where the start is on the axis.
        """
        here = Transform.from_array(start)
        frame = self.frame(here)
        axis = np.array(frame.direction(self.normal))
        axis /= np.linalg.norm(axis)
        angle = math.tau * self.turns
        curve = Round.about(here.position, np.array(frame.point(self.center)), axis, angle)
        if math.hypot(*curve.radius) < LEAST_RADIUS:
            raise ConfigError(
                "the circle's axis, through center along normal, passes through the start of the"
                " target, so the circle has no radius; move center"
            )
        x, y, z = axis.tolist()
        turn = Turn(here.quaternion, (x, y, z), angle if self.orientation == "follow" else 0.0)
        return self.timed([Segment(curve, turn)])
