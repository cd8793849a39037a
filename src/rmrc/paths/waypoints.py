"""The path through a list of poses."""

import pathlib
from itertools import accumulate
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rmrc.paths.base import TimedPath, Trajectory
from rmrc.paths.geometry import Transform, through
from rmrc.text.base import Pose


class WaypointsPath(TimedPath):
    """Straight lines from the start through each pose in turn, the profile applied to each line.

    A line takes time in proportion to its length. The target rests for an instant at every pose,
    except with the profile `constant`, which passes through at one speed.
    """

    path: Literal["waypoints"] = "waypoints"
    through: Annotated[tuple[Pose, ...], Field(min_length=1)]
    """The poses; what one leaves out stays as at the pose before it."""

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory of all lines; see `PathModel.build`."""
        here = Transform.from_array(start)
        frame = self.frame(here)
        places = accumulate(self.through, lambda at, pose: frame.place(pose, at), initial=here)
        return self.timed(through(places))
