"""The path that jumps to a pose."""

import pathlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rmrc.paths.base import MovingPath, Trajectory
from rmrc.paths.geometry import Segment, Transform
from rmrc.text.base import Pose


class PosePath(MovingPath, Pose):
    """The target jumps to a pose, after the delay, and stays there."""

    path: Literal["pose"] = "pose"

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory of one jump, which takes no time; see `PathModel.build`."""
        here = Transform.from_array(start)
        there = self.frame(here).place(self, here)
        return Trajectory([Segment.between(here, there)], [self.delay, self.delay])
