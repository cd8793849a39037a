"""Directions that are preserved: along none nothing moves, and along little there is little."""

from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

# m/s and rad/s: what a level's solver leaves of J v = 0.
STILL = 1e-9


def made(engine: str, priority: str, level: int) -> rmrc.Controller:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "preserve": "direction"}
    posture = {"name": "posture", "type": "posture", "level": level, "target": [0.1] * 7}
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    given = config(scene, [hand, posture], start="home", dt=0.002, priority=priority)
    return rmrc.Controller(rmrc.compile(given), engine)  # type: ignore


def moved(controller: rmrc.Controller, by: float) -> Any:
    """Return J v of the hand, and its error, for a target that far off."""
    controller.reset()
    target = controller.problem.term["hand"].target
    controller.set_target("hand", target[4:] + np.array([by, 0.0, 0.0]))
    step = controller.step()
    evaluation = controller.engine.evaluation
    return evaluation.jacobian[:6] @ step.v, evaluation.error[:6].copy()


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("priority", ["soft", "strict"])
def test_along_no_direction_nothing_moves(engine: str, priority: str, level: int) -> None:
    """However much another task of its level would have it move."""
    controller = made(engine, priority, level)
    assert np.abs(moved(controller, 0.0)[0]).max() < STILL


@pytest.mark.parametrize("by", [1e-9, 1e-7, 1e-5, 1e-3])
def test_a_small_error_asks_for_a_small_motion(engine: str, by: float) -> None:
    v, error = moved(made(engine, "soft", 0), by)
    assert np.abs(v - 10.0 * error).max() < 1e-6 * by + STILL
