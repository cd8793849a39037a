"""Objects in methods, physics, pairs and records."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes_with_objects import ARM, BENT, CUP, DOOR, DRIVEN, GRASP, HAND, MOTORS, POSTURE, scene

import rmrc
from models import config
from rmrc.errors import ConfigError
from rmrc.limits.collision import CollisionPairs
from rmrc.record.channels import positions, rates
from rmrc.record.manifest import manifest
from rmrc.record.plots import panels


@pytest.fixture
def made(tmp_path: Path) -> Any:
    """What makes a configuration of a scene's text."""

    def make(text: str, tasks: list[dict[str, Any]], **others: Any) -> rmrc.Config:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.xml"
        path.write_text(text)
        return config(str(path), tasks, **{"dt": 0.005} | others)

    return make


@pytest.mark.parametrize("method", ["qp", "pinv", "dls", "transpose", "sdls", "saturated",
                                    "descent", "nullspace"])  # fmt: skip
@pytest.mark.parametrize("follow", ["rate", "waypoints", "joint"])
def test_no_method_moves_an_object(made: Any, method: str, follow: str) -> None:
    tasks = [HAND, POSTURE, {**GRASP, "B": {"position": 0.1, "orientation": 0.0}}]
    targets = {"hand": {"path": "line", "to": {"position": [0.5, 0.3, 0.3]}, "duration": 0.1}}
    run = rmrc.solve(made(DRIVEN, tasks, start=BENT, method=method, follow=follow, duration=0.15,
                          targets=targets, dt=0.01))  # fmt: skip
    assert not run.v[:, 2:].any()
    np.testing.assert_array_equal(run.q[:, 2:], np.tile(run.q[0, 2:], (len(run.q), 1)))
    assert np.ptp(run.q[:, 0]) > 1e-3


def test_in_the_physics_objects_move_by_themselves(made: Any) -> None:
    """The cup falls to the floor; the hand follows where it is measured."""
    text = scene(ARM, CUP, DOOR, actuators=MOTORS)
    run = rmrc.solve(made(text, [GRASP], start=BENT, execute="actuated", duration=0.5,
                          actuation={"noise": 1e-4}))  # fmt: skip
    assert run.q[0, 4] - run.q[-1, 4] > 0.2
    assert not run.v[:, 2:].any()
    assert run.q_commanded is not None
    np.testing.assert_array_equal(run.q_commanded[:, 2:], np.tile(run.q[0, 2:], (len(run.q), 1)))


def test_pairs_that_the_robot_does_not_move_are_dropped(made: Any) -> None:
    everything = {"collision": {"pairs": "all", "d_min": 0.01, "detect": 0.05}}
    problem = rmrc.compile(made(DRIVEN, [HAND], limits=everything))
    model, objects = problem.model, problem.objects.bodies
    geoms = pairs_of(problem)
    ours = ~objects[model.geom_bodyid[geoms]] & (model.geom_bodyid[geoms] > 0)
    assert ours.any(axis=1).all()
    seen = {model.geom(int(geom)).name for geom in geoms.ravel()}
    assert {"cup_geom", "panel", "bolt", "floor"} <= seen
    named = [["cup", "door"], ["cup_geom", "floor"], ["hand_geom", "cup"]]
    problem = rmrc.compile(made(DRIVEN, [HAND], limits={
        "collision": everything["collision"] | {"pairs": named}}))  # fmt: skip
    assert len(pairs_of(problem)) == 1
    said = [line for line in problem.notices if "that the robot does not move" in line]
    assert len(said) == 2
    with pytest.raises(ConfigError, match="that the robot does not move"):
        rmrc.compile(made(DRIVEN, [HAND], limits={
            "collision": everything["collision"] | {"pairs": named[:2]}}))  # fmt: skip


def pairs_of(problem: rmrc.Problem) -> NDArray[np.intp]:
    (pairs,) = problem.barriers
    assert isinstance(pairs, CollisionPairs)
    return pairs.geoms


def test_clearance_counts_pairs_that_the_robot_moves(made: Any) -> None:
    clear = {"name": "clear", "type": "clearance", "distance": 1.0,
             "pairs": [["hand_geom", "cup"], ["door", "floor"], ["door", "cup"]]}  # fmt: skip
    problem = rmrc.compile(made(DRIVEN, [HAND, clear]))
    assert problem.named("clear").rows == 1
    clear["pairs"] = [["door", "floor"]]
    with pytest.raises(ConfigError, match="objects or fixed"):
        rmrc.compile(made(DRIVEN, [HAND, clear]))


def test_record_and_explanations_are_of_the_robot(made: Any) -> None:
    target = {"path": "pose", "position": [0, 0.4, 0.3]}
    problem = rmrc.compile(made(DRIVEN, [HAND, POSTURE], start=BENT, duration=0.1,
                                limits={"velocity": {"default": 0.05}},
                                targets={"hand": target}))  # fmt: skip
    model = manifest(problem, [])["model"]
    assert [joint["name"] for joint in model["joints"]] == ["j1", "j2"]
    assert model["objects"] == ["cup", "door"]
    run = rmrc.solve(problem)
    assert [channel.name for channel in positions(model, run.q)] == ["j1", "j2"]
    assert [channel.name for channel in rates(model, run.v, "velocity")] == ["j1", "j2"]
    drawn = {panel["title"]: panel for panel in panels(run)["panels"]}
    assert set(drawn["Active limits"]["rows"]) <= {"j1", "j2"}
    assert len(drawn["Joint velocities"]["traces"]) == 2
    controller, q = rmrc.Controller(problem), problem.start.copy()
    q[2:5] += 1.0  # the cup has moved: that is no error of the posture's
    controller.set_target("hand", position=[0, 0.4, 0.3])
    said = controller.step(q).explain()
    assert {binding.name for binding in said.bindings} <= {"j1", "j2"}
    assert controller.step(q).error["posture"][0] < 0.1
    posture = next(task for task in said.tasks if task.name == "posture")
    assert posture.asked[0] < 0.1
