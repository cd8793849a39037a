"""The path that stays where it is."""

import pathlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rmrc.paths.base import PathModel, Trajectory
from rmrc.paths.geometry import Segment, Transform


class HoldPath(PathModel):
    """The target stays at its pose at the start of the run."""

    path: Literal["hold"] = "hold"

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory that rests at the start; see `PathModel.build`."""
        place = Transform.from_array(start)
        return Trajectory([Segment.between(place, place)], [0.0, 0.0])
