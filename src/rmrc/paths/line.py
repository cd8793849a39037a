"""The straight path."""

import pathlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, Field

from rmrc.paths.base import TimedPath, Trajectory
from rmrc.paths.geometry import Segment, Transform
from rmrc.text.base import Pose


class LinePath(TimedPath):
    """A straight line to a pose, turning the shortest way at the same share of the path."""

    path: Literal["line"] = "line"
    # `from` is a word of Python's; files say `from`, Python says `from_`.
    from_: Pose | None = Field(
        default=None, validation_alias=AliasChoices("from", "from_"), serialization_alias="from"
    )
    """Where the line begins, and the target waits; absent: the target's pose at the start of the
    run, of which a pose keeps what it leaves out."""
    to: Pose
    """Where the line ends; what it leaves out stays as where the line begins."""

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory of the line; see `PathModel.build`."""
        here = Transform.from_array(start)
        frame = self.frame(here)
        begin = here if self.from_ is None else frame.place(self.from_, here)
        return self.timed([Segment.between(begin, frame.place(self.to, begin))])
