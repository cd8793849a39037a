"""A quaternion and its negative are one rotation: in a target, in q, in a path and in a start."""

import numpy as np
import pytest
from hypothesis import given
from random_robots import (
    OFF,
    assert_close,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
)

import rmrc
from models import config, random_quaternion

# Rounding of the logarithm, which a sign may change, times conditions up to 1e4.
SAME_ROTATION = 1e-10

WAYS = [
    {},
    {"priority": "strict"},
    {"limits": {"velocity": {"default": 0.3}}},
    {"method": "pinv"},
    {"method": "sdls"},
    {"method": "descent"},
]


@each_robot
@pytest.mark.parametrize("way", WAYS, ids=["qp", "strict", "limits", "pinv", "sdls", "descent"])
@examples(5)
@given(numbers)
def test_the_sign_of_a_targets_quaternion(robot, way, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    frame = {"frame": {"site": arm.site}, "B": {"position": 1.0, "orientation": 0.5}}
    tasks = (
        {"name": "hand", "type": "frame", **frame},
        {"name": "world", "type": "frame", **frame, "axes": "world"},
        {"name": "relative", "type": "relative_frame", **frame, "root": arm.root},
    )
    quaternions = [random_quaternion(rng) for _ in tasks]
    twists = rng.normal(size=(len(tasks), 6))
    controller = arm.controller(*tasks, **{"damping": {"lambda": 0.1}, **way})
    q = random_moment(controller, rng).q
    rates = []
    for sign in (1.0, -1.0):
        controller.reset()
        for task, quaternion, twist in zip(tasks, quaternions, twists, strict=True):
            assert controller.set_target(task["name"], quaternion=sign * quaternion, velocity=twist)
        rates.append(controller.step(q).v)
    assert_close(rates[1], rates[0], SAME_ROTATION)


@examples(20)
@given(numbers)
def test_the_sign_of_a_floating_bases_quaternion(tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    robot = random_robot("biped", rng, tmp_path_factory.getbasetemp())
    tasks = (robot.hand(), {"name": "posture", "type": "posture", "level": 1, "B": 0.1})
    controller = robot.controller(*tasks, damping={"lambda": 0.1})
    moment = random_moment(controller, rng)
    q = controller.problem.start.copy()
    q[3:7] = -q[3:7]
    turned = robot.controller(*tasks, damping={"lambda": 0.1}, start=q.tolist())
    step = moment.step(controller)
    assert_close(moment.step(turned).v, step.v, SAME_ROTATION)
    moment.q[3:7] *= -1.0
    other = moment.step(controller)
    assert_close(other.v, step.v, SAME_ROTATION)
    step.q[3:7] *= -1.0
    assert_close(other.q, step.q, SAME_ROTATION)


@pytest.mark.parametrize("path", ["line", "pose", "waypoints"])
@examples(3)
@given(numbers)
def test_the_sign_of_a_paths_quaternions(repository, path, number) -> None:
    rng = np.random.default_rng(number)
    quaternions = [random_quaternion(rng) for _ in range(2)]
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    runs = []
    for sign in (1.0, -1.0):
        first = {"position": [0.4, -0.2, 0.5], "quaternion": (sign * quaternions[0]).tolist()}
        second = {"position": [0.4, 0.2, 0.5], "quaternion": quaternions[1].tolist()}
        targets = {
            "line": {"path": "line", "to": first, "duration": 0.1},
            "pose": {"path": "pose", **first},
            "waypoints": {"path": "waypoints", "through": [first, second], "duration": 0.1},
        }
        made = config(
            str(repository / "scenes" / "panda.xml"),
            [hand],
            targets={"hand": targets[path]},
            duration=0.1,
            dt=0.005,
            limits=OFF,
        )
        runs.append(rmrc.solve(made))
    assert np.abs(np.diff(runs[0].q, axis=0)).max() > 1e-3
    assert_close(runs[1].q, runs[0].q, SAME_ROTATION)
