"""The transpose is slower than the inverse near the goal, and keeps calm where that one blows up."""

from dataclasses import replace

import mink
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import (
    Moment,
    Robot,
    asked,
    assert_close,
    each_robot,
    examples,
    numbers,
    planar_arm,
    random_moment,
    random_robot,
    unit_links,
)

REACHED = 1e-6
MOST = 2000


def iterations(arm: Robot, method: str, q: np.ndarray, target: np.ndarray) -> int:
    """Return how many whole steps from q bring the hand to within a micrometre of a point."""
    controller = arm.controller(arm.hand(axes="world", gain="deadbeat"), method=method)
    assert controller.set_target("hand", target)
    for count in range(MOST):
        step = controller.step(q)
        if step.error["hand"][0] <= REACHED:
            return count
        q = step.q
    return MOST
