"""What the closed forms report of a step, and what they say they leave out."""

from pathlib import Path
from typing import Any

import mink
import pytest

import rmrc
from models import config, scene_path
from rmrc.control.methods import shortcomings

HAND = {
    "name": "hand",
    "type": "frame",
    "frame": {"site": "hand"},
    "axes": "world",
    "B": {"position": 1.0, "orientation": 0.0},
}


def straight_arm(method: str, limit: float, **others: Any) -> rmrc.Config:
    limits = {"velocity": {"default": limit}, **others}
    scene = scene_path("planar_3r", Path())
    return config(scene, [HAND], method=method, start=[0.0, 0.0, 0.0], limits=limits)


@pytest.mark.parametrize(
    ("method", "limit", "flags"),
    [
        ("saturated", 0.4, set()),  # v = [0.3, 0.2, 0.1]
        ("saturated", 0.25, {"LIMITED"}),  # v = [0.25, 0.25, 0.15] is as fast
        ("saturated", 0.2, {"LIMITED", "SCALED"}),  # 6 · 0.2 m/s is the most
        ("pinv", 0.2, set()),  # keeps no limits
    ],
)
def test_saturated_says_what_the_limits_did(method: str, limit: float, flags: set[str]) -> None:
    controller = rmrc.Controller(rmrc.compile(straight_arm(method, limit)))
    for _ in range(2):  # nothing is left over from the step before
        # Across unit links along x, J = [3, 2, 1].
        controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 1.4, 0, 0, 0, 0])
        step = controller.step([0.0, 0.0, 0.0])
        assert {flag.name for flag in step.flags} == (flags or {"OK"})
        controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 0.14, 0, 0, 0, 0])
        assert controller.step([0.0, 0.0, 0.0]).status is rmrc.Status.OK


def test_tasks_of_minks_are_said_to_be_left_out() -> None:
    loaded = straight_arm("pinv", 1.0)
    model = rmrc.compile(loaded).model
    tasks = [mink.DampingTask(model, cost=1.0), mink.DampingTask(model, cost=2.0)]
    assert not any("mink" in line for line in shortcomings(rmrc.compile(loaded)))
    lines = shortcomings(rmrc.compile(loaded, mink_tasks=tasks))
    assert lines[-1] == "method pinv has no place for tasks of mink's: DampingTask, DampingTask"


def test_saturated_says_that_it_keeps_the_limits_of_the_joints_alone() -> None:
    plane = {"frame": {"site": "hand"}, "normal": [0, 1, 0], "offset": -1.0}
    loaded = straight_arm("saturated", 1.0, workspace=[plane])
    lines = shortcomings(rmrc.compile(loaded))
    assert lines == ["method saturated keeps the limits of the joints, and no others"]
