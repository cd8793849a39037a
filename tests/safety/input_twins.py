"""Two controllers, one of which is given what is wrong."""

from functools import cache
from pathlib import Path

import numpy as np
from matrix import LIMITS
from numpy.typing import NDArray
from obstacles import beside_a_ball

import rmrc

Array = NDArray[np.float64]
# A shift of the hand's target that takes many steps to follow, m.
SHIFT = (0.05, -0.04, 0.06)


@cache
def compiled(robot: str, folder: Path, accelerates: bool) -> rmrc.Problem:
    """Return a problem that reads all there is to read, at once or with acceleration limits."""
    limits = LIMITS if accelerates else {**LIMITS, "acceleration": "off"}
    made = beside_a_ball(robot, folder).config(
        limits=limits, previous="measured", timeout={"target": 1.0, "measurement": 1.0}
    )
    return rmrc.compile(made)
