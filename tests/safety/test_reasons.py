"""A robot that is stuck says why: out of reach, held back by what, or blocked by what."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc import Status
from rmrc.runs.why import why

DT = 0.002
SECONDS = 4.0
SAID = 0.02
"""Share by which a number that is said may be off, for it has two digits."""
REST = 1e-3
"""Largest rate of a robot at rest, rad/s."""

ARM = """<mujoco><worldbody>
  <geom name="post" type="cylinder" size="0.05 0.5" pos="0.9 0.25 0"/>
  <body name="b1"><joint name="j1" axis="0 0 1"/>
    <geom name="link1" type="capsule" size="0.03" fromto="0 0 0 0.5 0 0"/>
    <body name="b2" pos="0.5 0 0"><joint name="j2" axis="0 0 1"/>
      <geom name="link2" type="capsule" size="0.03" fromto="0 0 0 0.5 0 0"/>
      <body name="b3" pos="0.5 0 0"><joint name="j3" axis="0 0 1"/>
        <geom name="link3" type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
        <site name="tip" pos="0.3 0 0"/>
      </body>
    </body>
  </body>
</worldbody></mujoco>"""
REACH = 1.3
START = {"j1": -0.8, "j2": 0.9, "j3": 0.3}
TIP = {
    "name": "tip",
    "type": "frame",
    "frame": {"site": "tip"},
    "B": {"position": 1.0, "orientation": 0.0},
}
POST = {"collision": {"pairs": [["link1", "post"], ["link2", "post"], ["link3", "post"]]}}


def stuck(tmp_path: Path, engine: Any, target: list[float], *tasks: dict[str, Any], **options: Any):
    """Return the last step of the arm, which has to be stuck."""
    scene = tmp_path / "arm.xml"
    scene.write_text(ARM)
    made = config(str(scene), [TIP, *tasks], start=START, dt=DT, **options)
    controller = rmrc.Controller(rmrc.compile(made), engine)
    assert controller.set_target("tip", target)
    step = controller.step()
    assert step.reasons == ()
    for _ in range(round(SECONDS / DT)):
        step = controller.step()
    assert Status.STUCK in step.flags
    assert np.abs(step.v).max() <= REST
    return step


def test_a_target_beyond_the_reach(tmp_path: Path, engine: Any) -> None:
    step = stuck(tmp_path, engine, [1.2, 0.9, 0.0])
    [reason] = step.reasons
    assert reason == f"out of reach by {np.hypot(1.2, 0.9) - REACH:.2g} m"
    assert f"tip: {reason}; bring the target 0.2 m nearer" in str(step.explain())


def test_a_posture_that_pulls_the_other_way(tmp_path: Path, engine: Any) -> None:
    posture = {"name": "posture", "type": "posture", "B": 0.02, "target": {"j2": -1.0}}
    step = stuck(tmp_path, engine, [0.6, 0.6, 0.0], posture)
    [reason] = step.reasons
    start, end = "posture holds tip back by ", " mm"
    assert reason.startswith(start)
    assert reason.endswith(end)
    assert 1e-3 * float(reason[len(start) : -len(end)]) == pytest.approx(
        step.error["tip"][0], rel=SAID
    )
    assert "lower B of posture" in str(step.explain())


@pytest.mark.parametrize("options", [{}, {"priority": "strict"}])
def test_a_range_in_the_way(tmp_path: Path, engine: Any, options: dict[str, Any]) -> None:
    limits = {"position": {"j2": [0.5, 1.0], "j3": [0.2, 0.4]}}
    step = stuck(tmp_path, engine, [0.2, 0.2, 0.0], limits=limits, **options)
    assert set(step.reasons) == {f"held back by j{k}: its position limit" for k in (2, 3)}
    assert "widen j2's range" in str(step.explain())


def test_a_post_in_the_way(tmp_path: Path, engine: Any) -> None:
    step = stuck(tmp_path, engine, [0.85, 0.6, 0.0], limits=POST)
    assert step.reasons == ("blocked by link3 and post",)
    assert "move the obstacle" in str(step.explain())


def test_two_tasks_are_told_apart(tmp_path: Path, engine: Any) -> None:
    # The other stays where it starts.
    step = stuck(tmp_path, engine, [0.6, 0.6, 0.0], {**TIP, "name": "other"})
    assert [reason.split(" by ")[0] for reason in step.reasons] == [
        "tip: other holds tip back",
        "other: tip holds other back",
    ]


def test_why_says_of_a_run_what_the_step_says(tmp_path: Path) -> None:
    scene = tmp_path / "arm.xml"
    scene.write_text(ARM)
    made = config(
        str(scene),
        [TIP],
        start=START,
        dt=DT,
        duration=SECONDS,
        targets={"tip": {"path": "pose", "position": [1.2, 0.9, 0.0]}},
    )
    number, account = why(rmrc.solve(made))
    assert number < SECONDS / DT
    assert account.status is Status.STUCK
    assert [reason.what for reason in account.reasons] == ["out of reach by 0.2 m"]


def test_a_step_within_the_tolerance_is_not_stuck(tmp_path: Path, engine: Any) -> None:
    scene = tmp_path / "arm.xml"
    scene.write_text(ARM)
    made = config(str(scene), [TIP], start=START, dt=DT)
    controller = rmrc.Controller(rmrc.compile(made), engine)
    assert controller.set_target("tip", [1.2, 0.9, 0.0])
    step = controller.step()
    for _ in range(round(SECONDS / DT)):
        step = controller.step()
    assert Status.STUCK in step.flags
    at = controller.problem.forward(step.q)["tip"][:3, 3]
    assert controller.set_target("tip", at)
    assert Status.STUCK not in controller.step().flags


def test_an_orientation_that_nobody_asked_for_is_the_reason(engine: Any) -> None:
    """The panda reaches the point at another orientation than the one of its start."""
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    target, said = [0.75, 0.0, 0.75], {}
    for name, task in (("pose", hand), ("point", {**hand, "B": [1, 1, 1, 0, 0, 0]})):
        controller = rmrc.Controller(rmrc.compile(config(scene, [task], dt=0.01)), engine)
        assert controller.set_target("hand", target)
        for _ in range(800):
            said[name] = controller.step()
    assert Status.STUCK in said["pose"].flags
    missed = float(said["pose"].error["hand"][0])
    assert float(said["point"].error["hand"][0]) < 1e-3
    (reason,) = said["pose"].reasons
    words, _, unit = reason.removeprefix("its orientation holds hand back by ").partition(" ")
    assert unit == "m"
    assert float(words) == pytest.approx(missed, rel=0.05)
