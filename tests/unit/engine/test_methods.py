"""What the closed forms report of a step, and what they say they leave out."""

from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest

import rmrc
from models import config, scene_path
from rmrc.engine.closed_form import shortcomings

SAME_STEP = 1e-6
"""rad/s; daqp's own tolerance, of Δq, is looser than what rmrc asks of it."""
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
        ("pinv", 0.2, {"LIMITED"}),  # keeps no limits, and passes one
    ],
)
def test_saturated_says_what_the_limits_did(method: str, limit: float, flags: set[str]) -> None:
    controller = rmrc.Controller(rmrc.compile(straight_arm(method, limit)))
    for _ in range(2):  # nothing is left over from the step before
        # Across unit links along x, J = [3, 2, 1].
        controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 1.4, 0, 0, 0, 0])
        step = controller.step([0.0, 0.0, 0.0])
        assert {flag.name for flag in step.flags} == (flags or {"OK"})
        joints = ["joint1"] if method == "pinv" else []
        assert [reason.split()[5] for reason in step.reasons] == joints
        controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0, 0.14, 0, 0, 0, 0])
        assert controller.step([0.0, 0.0, 0.0]).status is rmrc.Status.OK


def test_tasks_of_minks_are_said_to_be_left_out() -> None:
    loaded = straight_arm("pinv", 1.0)
    model = rmrc.compile(loaded).model
    tasks = [mink.DampingTask(model, cost=1.0), mink.DampingTask(model, cost=2.0)]
    assert not any("mink" in line for line in shortcomings(rmrc.compile(loaded)))
    lines = shortcomings(rmrc.compile(loaded, mink_tasks=tasks))
    assert lines[-1] == "method pinv has no place for tasks of mink's: DampingTask, DampingTask"


def test_saturated_says_which_limits_it_does_not_keep() -> None:
    plane = {"frame": {"site": "hand"}, "normal": [0, 1, 0], "offset": -1.0}
    loaded = straight_arm("saturated", 1.0, workspace=[plane])
    lines = shortcomings(rmrc.compile(loaded))
    assert lines == ["method saturated has no place for the limits workspace"]


def test_minks_step_is_that_of_rmrc_where_both_are_defined() -> None:
    loaded = straight_arm("mink", 0.25)
    hand = HAND | {"axes": "body", "B": [1.0, 2.0, 0.0, 0.0, 0.0, 0.5]}
    still = {"name": "still", "type": "freeze", "joints": ["joint2"]}
    posture = {"name": "posture", "type": "posture", "level": 1, "B": 0.1, "gain": 1.0}
    energy = {"name": "energy", "type": "kinetic_energy", "B": 0.01, "level": 1}
    controllers = [
        rmrc.Controller(
            rmrc.compile(
                config(
                    loaded.scene,
                    [hand, still, posture, energy],
                    method=method,
                    start=[0.3, 0.4, 0.5],
                    damping={"curvature": False},
                    limits={"velocity": {"default": 0.25}},
                )
            ),
            "python",
        )
        for method in ("qp", "mink")
    ]
    for controller in controllers:
        position = controller.problem.term["hand"].target[4:] + [0.1, -0.2, 0.0]
        controller.set_target("hand", position, [0.9, 0.0, 0.0, 0.1])
    steps = [[controller.step().v for controller in controllers] for _ in range(20)]
    qp, mink_ik = np.transpose(steps, (1, 0, 2))
    assert np.abs(qp - mink_ik).max() < SAME_STEP
    assert np.abs(qp).max() > 0.2


def test_mink_says_what_it_has_no_place_for() -> None:
    plane = {"frame": {"site": "hand"}, "normal": [0, 1, 0], "offset": -1.0}
    loaded = config(
        scene_path("planar_3r", Path()),
        [HAND, {"name": "smooth", "type": "smooth"}, {"name": "middle", "type": "centering"}],
        method="mink",
        priority="strict",
        metric=0.1,
        limits={"workspace": [plane], "acceleration": {"default": 5.0}},
        targets={"hand": {"path": "line", "to": {"position": [2.0, 0, 0]}, "duration": 1.0}},
    )
    assert shortcomings(rmrc.compile(loaded)) == [
        "method mink has no place for the limits acceleration, workspace",
        "method mink has no place for the tasks hand, smooth",
        "method mink has no place for a metric",
        "method mink has no place for strict levels",
        "method mink has no place for a feed-forward of what moves",
    ]


def test_where_mink_finds_no_solution_its_run_ends_with_the_reason() -> None:
    hand = HAND | {"axes": "body"}
    scene = scene_path("panda", Path())
    start = {"joint4": 0.5}  # outside its range by more than the velocity limit allows to come back
    limits = {"velocity": {"default": 1.0}}
    run = rmrc.solve(config(scene, [hand], method="mink", start=start, limits=limits))
    assert len(run.time) == 1
    assert run.manifest["notices"][0].startswith("mink: QP solver daqp failed")
    assert not run.summary["converged"]
