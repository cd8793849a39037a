"""The same numbers of other types, strides and norms give the same step."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from input_twins import SHIFT, Array
from matrix import each_backend, each_robot
from obstacles import AWAY, BALL

import rmrc
from rmrc import Status

# A number that is not the same bit for bit where it came through another type or norm.
SAME = 1e-12


def same(good: Array) -> Iterator[Any]:
    """Yield the same numbers in other clothes."""
    yield good.tolist()
    yield tuple(good)
    yield np.repeat(good, 3)[::3]
    yield good[::-1].copy()[::-1]
    yield np.asfortranarray(np.tile(good, (2, 1)))[1]
    yield np.tile(good[:, None], (1, 2))[:, 0]
    yield good.astype(">f8")
    yield good.astype(np.longdouble)
    yield np.frombuffer(b"x" + good.tobytes(), dtype=float, offset=1)  # not aligned
    frozen = good.copy()
    frozen.flags.writeable = False
    yield frozen


def shortened(good: Array) -> Iterator[Any]:
    """Yield numbers of types that not all floats fit into."""
    for kind in (np.float32, np.float16, np.int64, np.int8):
        yield good.astype(kind)
    yield good.round().astype(int).tolist()


def outcome(problem: rmrc.Problem, **given: Any) -> Array:
    """Return v of the second of two steps with other inputs than those of the problem's start."""
    controller = rmrc.Controller(problem)
    q, target = problem.start, problem.term["hand"].target
    inputs = {
        "q": q,
        "v": np.linspace(-0.01, 0.01, problem.model.nv),
        "position": target[4:] + SHIFT,
        "quaternion": target[:4],
        "velocity": np.linspace(-0.1, 0.1, 6),
        "posture": q,
        "ball": np.array(AWAY),
        **given,
    }
    assert controller.set_target(
        "hand", inputs["position"], inputs["quaternion"], inputs["velocity"]
    )
    assert controller.set_target("posture", q=inputs["posture"])
    assert controller.set_obstacle(BALL, inputs["ball"], inputs["quaternion"], inputs["velocity"])
    controller.step(inputs["q"], v=inputs["v"])
    step = controller.step(inputs["q"], v=inputs["v"])
    assert step.status < Status.MAX_ITER
    return step.v


@each_backend
@each_robot
def test_the_same_numbers_of_other_types_and_strides_give_the_same_step(
    slow: rmrc.Problem,
) -> None:
    target = slow.term["hand"].target
    given = {
        "q": slow.start,
        "v": np.linspace(-0.01, 0.01, slow.model.nv),
        "position": target[4:] + SHIFT,
        "quaternion": target[:4],
        "velocity": np.linspace(-0.1, 0.1, 6),
        "posture": slow.start,
        "ball": np.array(AWAY),
    }
    expected = outcome(slow)
    for name, value in given.items():
        for other in same(value):
            np.testing.assert_array_equal(outcome(slow, **{name: other}), expected, name)


@each_backend
@each_robot
def test_shorter_types_are_taken_for_the_numbers_they_hold(slow: rmrc.Problem) -> None:
    target = slow.term["hand"].target[4:] + SHIFT
    for short in shortened(target):
        expected = outcome(slow, position=np.asarray(short).astype(float))
        np.testing.assert_array_equal(outcome(slow, position=short), expected)
    for kind in (np.float32, np.float16):
        expected = outcome(slow, q=slow.start.astype(kind).astype(float))
        np.testing.assert_array_equal(outcome(slow, q=slow.start.astype(kind)), expected)


@each_backend
@each_robot
@pytest.mark.parametrize("norm", [2.0, 1e-9, 1e9, -1.0])
def test_a_quaternion_of_any_norm_is_the_same_target(slow: rmrc.Problem, norm: float) -> None:
    target = slow.term["hand"].target[:4]
    scaled = outcome(slow, quaternion=norm * target)
    np.testing.assert_allclose(scaled, outcome(slow), rtol=0.0, atol=1e3 * SAME)


@each_backend
@pytest.mark.parametrize("robot", ["biped", "g1"])
def test_a_floating_base_turns_by_a_quaternion_of_any_norm(slow: rmrc.Problem) -> None:
    q = slow.start.copy()
    for norm, valid in ((2.0, True), (0.0, False), (1e-20, False)):
        q[3:7] = norm * slow.start[3:7]
        step = rmrc.Controller(slow).step(q)
        assert (Status.INVALID_INPUT not in step.flags) is valid
        assert abs(float(np.linalg.norm(step.q[3:7])) - 1.0) < SAME


@each_backend
@each_robot
def test_what_is_given_is_not_written_to_or_kept(free: rmrc.Problem) -> None:
    controller = rmrc.Controller(free)
    target, q = free.term["hand"].target[4:] + SHIFT, free.start.copy()
    ball = np.array(AWAY)
    controller.set_target("hand", target)
    controller.set_target("posture", q=q)
    controller.set_obstacle(BALL, ball)
    first = controller.step(q)
    np.testing.assert_array_equal(q, free.start)
    first.q[:], first.v[:] = np.nan, np.nan
    for array in (target, q, ball):
        array[:] = np.nan
    second = controller.step()
    assert second.status < Status.MAX_ITER
    assert np.isfinite(second.q).all()


@pytest.fixture
def made(engine: str) -> rmrc.Controller:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    scene = str(Path(__file__).parents[2] / "scenes" / "panda.xml")
    given = {"scene": scene, "tasks": [hand], "start": "home"}
    return rmrc.Controller(rmrc.compile(rmrc.Config.model_validate(given)), engine)  # type: ignore
