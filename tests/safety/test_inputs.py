"""What comes in wrong is refused and leaves no trace; what is only unusual is taken as meant."""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from input_twins import SHIFT, Array
from matrix import ACCELERATION, DT, ROUNDING, each_backend, each_robot
from obstacles import AWAY, BALL

import rmrc
from braking import left_of
from rmrc import Status


class Object:
    """An array of another library, which gives no numbers."""

    def __array__(self, *_: object, **__: object) -> Array:
        raise RuntimeError("on another device")


def wrong(good: Array) -> Iterator[Any]:
    """Yield what is not such an array of real, finite numbers of a sensible size."""
    for value in (np.nan, np.inf, -np.inf, 1e200, -1e13):
        for k in (0, good.size - 1):
            bad = good.copy()
            bad[k] = value
            yield bad
            yield bad.tolist()
    yield good[:-1]
    yield np.append(good, 0.0)
    yield good[:, None]
    yield good[None]
    yield np.zeros(0)
    yield 0.5
    yield "straight"
    yield bytes(good.size)
    yield [str(number) for number in good]
    yield [*good[:-1], None]
    yield [*good[:-1], [0.0]]
    yield [10**400] * good.size
    yield [Fraction(1, 3)] * good.size
    yield good.astype(object)
    yield good + 0j
    yield good.astype(bool)
    yield good.astype(str)
    yield good.astype("datetime64[s]")
    yield np.full(good.size, np.longdouble("1e4000"))
    yield dict.fromkeys(good, 1.0)
    yield set(good)
    yield (number for number in good)
    yield Object()


class Twins:
    """Two controllers of one problem that get the same, but for what the test gives to one."""

    def __init__(self, problem: rmrc.Problem):
        self.problem = problem
        self.tried, self.twin = rmrc.Controller(problem), rmrc.Controller(problem)
        self.target = problem.term["hand"].target[4:] + SHIFT
        self.quaternion = problem.term["hand"].target[:4].copy()
        for each in (self.tried, self.twin):
            assert each.set_target("hand", self.target, self.quaternion)
            assert each.set_obstacle(BALL, AWAY)
        self.step(5)

    def step(self, count: int = 1) -> None:
        """Take good steps, and hold them to be the same."""
        for _ in range(count):
            first, second = self.tried.step(), self.twin.step()
            assert first.flags == second.flags
            assert Status.INVALID_INPUT not in first.flags
            np.testing.assert_array_equal(first.v, second.v)
            np.testing.assert_array_equal(first.q, second.q)

    def refuse(self, **given: Any) -> None:
        """Step with what is wrong: nothing moves, and the next steps are as if it had not been."""
        before, targets = self.tried.q, self.targets()
        step = self.tried.step(**given)
        assert step.flags == {Status.INVALID_INPUT}, given
        assert not step.v.any()
        np.testing.assert_array_equal(step.q, before)
        np.testing.assert_array_equal(self.tried.q, before)
        for old, new in zip(targets, self.targets(), strict=True):
            np.testing.assert_array_equal(old, new)
        self.step()

    def targets(self) -> list[Array]:
        """Return copies of the targets and of the obstacles."""
        evaluation = self.tried.engine.evaluation
        return [evaluation.targets.copy(), evaluation.twists.copy(), *evaluation.obstacles()]

    def refuse_target(self, name: str, **given: Any) -> None:
        """Set a target that is wrong: it is not taken, the next step says so, and no more."""
        targets = self.targets()
        assert self.tried.set_target(name, **given) is False, given
        self.hold(targets)

    def refuse_obstacle(self, **given: Any) -> None:
        targets = self.targets()
        assert self.tried.set_obstacle(BALL, **given) is False, given
        self.hold(targets)

    def hold(self, targets: list[Array]) -> None:
        for old, new in zip(targets, self.targets(), strict=True):
            np.testing.assert_array_equal(old, new)
        first, second = self.tried.step(), self.twin.step()
        assert Status.INVALID_INPUT in first.flags
        assert first.flags - {Status.INVALID_INPUT, Status.OK} == second.flags - {Status.OK}
        np.testing.assert_array_equal(first.v, second.v)
        self.step()


@each_backend
@each_robot
def test_a_wrong_q_stops_and_leaves_no_trace(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in wrong(twins.tried.q):
        twins.refuse(q=bad)


@each_backend
@each_robot
def test_a_wrong_v_stops_and_leaves_no_trace(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in wrong(np.linspace(-0.1, 0.1, free.model.nv)):
        twins.refuse(q=twins.tried.q, v=bad)


NO_TIMES = [np.nan, np.inf, -np.inf, -DT, 10**400, "0.002", "now", 1j, [DT], [DT, DT], object()]


@each_backend
@each_robot
def test_a_wrong_dt_stops_and_leaves_no_trace(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in [*NO_TIMES, 0.0, 1e-300, 1e300]:
        twins.refuse(dt=bad)


@each_backend
@each_robot
def test_a_wrong_age_is_of_no_measurement(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in [*NO_TIMES, None]:
        step = twins.tried.step(twins.tried.q, age=bad)
        assert step.status in (Status.STALE, Status.INVALID_INPUT), bad
        assert not step.v.any()
        assert twins.tried.step(twins.tried.q).status < Status.STALE


@each_backend
@each_robot
def test_a_wrong_target_is_refused_and_leaves_no_trace(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in wrong(twins.target):
        twins.refuse_target("hand", position=bad)
        twins.refuse_target("hand", position=bad, quaternion=[1.0, 0.0, 0.0, 0.0])
    for bad in [*wrong(twins.quaternion), np.zeros(4), [1e-20, 0.0, 0.0, 0.0]]:
        twins.refuse_target("hand", quaternion=bad)
        twins.refuse_target("hand", position=twins.target + 0.1, quaternion=bad)
    for bad in wrong(np.linspace(-0.1, 0.1, 6)):
        twins.refuse_target("hand", position=twins.target + 0.1, velocity=bad)
    for bad in wrong(twins.tried.q):
        twins.refuse_target("posture", q=bad)
    twins.refuse_target("posture")
    twins.refuse_target("hand", direction=[0.0, 0.0, 1.0])
    twins.refuse_target("hand", position=twins.target, q=twins.tried.q)


@each_backend
@each_robot
def test_a_wrong_obstacle_is_refused_and_leaves_no_trace(free: rmrc.Problem) -> None:
    twins = Twins(free)
    for bad in wrong(np.array(AWAY)):
        twins.refuse_obstacle(position=bad)
    for bad in [*wrong(twins.quaternion), np.zeros(4), [1e-20, 0.0, 0.0, 0.0]]:
        twins.refuse_obstacle(position=[1.0, 2.0, 3.0], quaternion=bad)
    for bad in wrong(np.linspace(-0.1, 0.1, 6)):
        twins.refuse_obstacle(position=[1.0, 2.0, 3.0], velocity=bad)


@each_backend
@each_robot
def test_wrong_input_brakes_at_the_acceleration_limit(slow: rmrc.Problem) -> None:
    controller = rmrc.Controller(slow)
    controller.set_target("hand", slow.term["hand"].target[4:] + 5.0 * np.array(SHIFT))
    step = controller.step()
    for _ in range(20):
        step = controller.step()
    change, fastest = np.full(slow.model.nv, np.inf), float(np.abs(step.v).max())
    change[slow.dofs] = slow.box.acceleration * DT
    assert fastest > 5.0 * ACCELERATION * DT
    bad = wrong(controller.q)
    while step.v.any():
        before, q = step.v, controller.q
        step = controller.step(next(bad))
        assert step.flags == {Status.INVALID_INPUT}
        np.testing.assert_allclose(step.v, left_of(before, change), rtol=0.0, atol=ROUNDING)
        moved = np.empty(slow.model.nv)
        mujoco.mj_differentiatePos(slow.model, moved, DT, q, step.q)
        np.testing.assert_allclose(moved, step.v, rtol=0.0, atol=1e-6)
    assert Status.INVALID_INPUT not in controller.step().flags


class Raises:
    """A length of a step of another library's, which gives no number."""

    def __float__(self) -> float:
        raise RuntimeError("on another device")


WRONG_STEPS = {
    "q[1] is nan": {"q": [0.0, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]},
    "q has the shape (2,), and not (7,)": {"q": [0.0, 0.0]},
    "q is no array of numbers, but a str": {"q": "straight"},
    "q[0] is 1e+13, and no number is beyond 1e+12": {"q": [1e13] * 7},
    "dt is -0.002, and no time of 1e-09 to 1000 s": {"dt": -0.002},
    "dt is a Raises, and no time of 1e-09 to 1000 s": {"dt": Raises()},
}
WRONG_TARGETS = {
    "position[2] is inf": {"position": [0.0, 0.0, np.inf]},
    "quaternion is zero, and has no direction": {"quaternion": [0.0] * 4},
    "velocity has the shape (3,), and not (6,)": {"velocity": [0.0] * 3},
    "it takes no q": {"q": [0.0] * 7},
}


@pytest.fixture
def made(engine: str) -> rmrc.Controller:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    scene = str(Path(__file__).parents[2] / "scenes" / "panda.xml")
    given = {"scene": scene, "tasks": [hand], "start": "home"}
    return rmrc.Controller(rmrc.compile(rmrc.Config.model_validate(given)), engine)  # type: ignore


@pytest.mark.parametrize("what", WRONG_STEPS)
def test_a_step_says_which_argument_is_wrong(made: rmrc.Controller, what: str) -> None:
    step = made.step(**WRONG_STEPS[what])
    assert step.status is Status.INVALID_INPUT
    assert step.reasons == (f"{what}; the robot brakes",)
    assert what in str(step.explain())
    assert made.step().reasons == ()


@pytest.mark.parametrize("what", WRONG_TARGETS)
def test_a_step_says_which_part_of_a_target_was_wrong(made: rmrc.Controller, what: str) -> None:
    assert not made.set_target("hand", **WRONG_TARGETS[what])
    step = made.step()
    assert step.status is Status.INVALID_INPUT
    assert step.reasons == (f"target of hand: {what}; the last good one stays",)
    assert made.step().reasons == ()
