"""Steps of any length, on a clock that jitters, and on inputs that come late."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from matrix import (
    ACCELERATION,
    DT,
    ROUNDING,
    Checked,
    each_backend,
    each_robot,
    problem,
    with_backend,
)
from numpy.typing import NDArray

import rmrc
from braking import left_of
from rmrc import Status

Array = NDArray[np.float64]

TICKS = 20
"""Timeout of targets and measurements, in steps."""
NEAR = (0.01, -0.01, 0.01)
"""A shift of the hand's target within reach, m."""
FAR = (0.3, 0.3, -0.3)
"""One that keeps the joints at their limits, m."""
# What V may rise by, which is at most 0.01 m²/s: rounding of the configuration.
SETTLED = 1e-12


@cache
def compiled(robot: str, *options: tuple[str, Any]) -> rmrc.Problem:
    return problem(robot, "auto", **{key: dict(value) for key, value in options})


@pytest.fixture
def made(robot: str, backend: str) -> rmrc.Problem:
    return with_backend(compiled(robot), backend)


@pytest.fixture
def timed(robot: str, backend: str) -> rmrc.Problem:
    """The problem with timeouts of 20 ticks."""
    timeout = (("target", TICKS * DT), ("measurement", TICKS * DT))
    return with_backend(compiled(robot, ("timeout", timeout)), backend)


def aimed(problem: rmrc.Problem, shift: tuple[float, float, float]) -> Checked:
    """Return a controller, whose steps are checked, with a target beside the hand."""
    checked = Checked(problem)
    assert checked.controller.set_target("hand", problem.term["hand"].target[4:] + shift)
    return checked


@each_backend
@each_robot
@pytest.mark.parametrize("dt", [1e-9, 0.1, 10.0])
def test_steps_of_any_length_keep_the_limits(made: rmrc.Problem, dt: float) -> None:
    checked = aimed(made, FAR)
    for _ in range(6):
        assert checked.step(dt=dt).status < Status.STALE


@each_backend
@each_robot
@pytest.mark.parametrize("dt", [0.1, 10.0])
def test_long_steps_do_not_pass_their_target(made: rmrc.Problem, dt: float) -> None:
    # The gain is capped at 1/dt, so that no step asks for more than the whole error.
    checked, error, potential = aimed(made, NEAR), [], []
    evaluation = checked.controller.engine.evaluation
    for _ in range(8):
        error.append(checked.step(dt=dt).error["hand"][0])
        potential.append(0.0)
        for term in made.terms:
            part = evaluation.error_of(evaluation.error, term)
            potential[-1] += 0.5 * min(term.gain, 1.0 / dt) * float(part @ (term.weight * part))
    # Where the tasks have come to their balance the hand may give way to the others.
    assert all(then <= now + SETTLED for now, then in pairwise(potential)), potential
    assert error[-1] < 0.6 * error[0]  # the posture holds ALOHA's six joints back


@each_backend
@each_robot
def test_a_step_of_another_length_between_leaves_no_trace(made: rmrc.Problem) -> None:
    jumped, twin = aimed(made, NEAR), aimed(made, NEAR)
    for each in (jumped, twin):
        for _ in range(3):
            each.step()
    q, v = jumped.q, jumped.v
    for dt in (1e-9, 10.0, 0.1):
        jumped.step(dt=dt)
    jumped.reset(q, v)
    jumped.controller.set_target("hand", made.term["hand"].target[4:] + NEAR)
    np.testing.assert_allclose(jumped.step().v, twin.step().v, rtol=0.0, atol=1e-6)


@each_backend
@each_robot
@pytest.mark.parametrize("shift", [NEAR, FAR], ids=["near", "far"])
def test_limits_hold_on_a_clock_that_jitters(
    made: rmrc.Problem, shift: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(0)
    checked = aimed(made, shift)
    first = last = checked.step().error["hand"][0]
    for dt in DT * rng.uniform(0.5, 1.5, 60):
        step = checked.step(checked.q, dt=dt)
        assert step.status < Status.STALE
        last = step.error["hand"][0]
    assert last < first


def _late_target(checked: Checked, ticks: int) -> rmrc.Step:
    """Step with a target that is some ticks old, and measurements of now."""
    assert checked.controller.set_target("hand", checked.problem.term["hand"].target[4:] + FAR)
    for _ in range(ticks):
        assert Status.STALE not in checked.step(checked.q).flags
    return checked.step(checked.q)


def _late_measurement(checked: Checked, ticks: int) -> rmrc.Step:
    """Step without measurements for some ticks, with targets of now."""
    checked.step(checked.q)
    for _ in range(ticks - 1):
        _renew(checked)
        assert Status.STALE not in checked.step().flags
    _renew(checked)
    return checked.step()


def _aged_measurement(checked: Checked, ticks: int) -> rmrc.Step:
    """Step with a measurement that says that it is some ticks old, with a target of now."""
    _renew(checked)
    return checked.step(checked.q, age=ticks * DT)


def _renew(checked: Checked) -> None:
    checked.controller.set_target("hand", checked.problem.term["hand"].target[4:] + FAR)


@each_backend
@each_robot
@pytest.mark.parametrize("late", [_late_target, _late_measurement, _aged_measurement])
def test_what_is_older_than_its_timeout_brakes_until_it_is_fresh(
    timed: rmrc.Problem, late: Callable[[Checked, int], rmrc.Step]
) -> None:
    for ticks, stale in ((1, False), (5, False), (TICKS, False), (TICKS + 1, True)):
        checked = aimed(timed, FAR)
        for _ in range(10):
            _renew(checked)
            checked.step(checked.q)
        step = late(checked, ticks)
        assert (Status.STALE in step.flags) is stale, ticks
        assert (step.status is Status.STALE) is stale
    assert checked.controller.failures == 1
    braked, before = 0, step.v[timed.dofs]
    while step.v.any():
        before = step.v[timed.dofs]
        step = checked.step(age=np.inf) if late is _late_target else checked.step()
        expected = left_of(before, timed.box.acceleration * DT)
        np.testing.assert_allclose(step.v[timed.dofs], expected, rtol=0.0, atol=ROUNDING)
        assert step.flags == {Status.STALE}
        braked += 1
        assert checked.controller.failures == 1 + braked
    assert braked > 5
    assert float(np.abs(before).max()) <= ACCELERATION * DT + ROUNDING
    _renew(checked)
    step = checked.step(checked.q)
    assert step.status < Status.STALE
    assert step.v.any()
    assert checked.controller.failures == 0


@each_backend
@each_robot
def test_a_target_that_was_never_set_is_never_stale(timed: rmrc.Problem) -> None:
    checked = Checked(timed)
    for _ in range(TICKS + 5):
        assert Status.STALE not in checked.step(checked.q).flags


@each_backend
@pytest.mark.parametrize("robot", ["panda", "biped"])
def test_a_timeout_counts_time_not_steps(timed: rmrc.Problem) -> None:
    for dt, steps in ((0.5 * DT, 2 * TICKS), (TICKS * DT, 1), (2.0 * TICKS * DT, 0)):
        checked = aimed(timed, NEAR)
        for _ in range(steps + 1):
            assert Status.STALE not in checked.step(checked.q, dt=dt).flags
        assert checked.step(checked.q, dt=dt).status is Status.STALE


@each_backend
@pytest.mark.parametrize("robot", ["panda", "biped"])
def test_one_fresh_target_does_not_hide_a_stale_one(timed: rmrc.Problem) -> None:
    checked = aimed(timed, NEAR)
    checked.controller.set_target("posture", q=timed.start)
    for tick in range(TICKS + 3):
        checked.controller.set_target("hand", timed.term["hand"].target[4:] + NEAR)
        assert (Status.STALE in checked.step(checked.q).flags) is (tick > TICKS)
    checked.controller.reset()
    checked.reset()
    assert Status.STALE not in checked.step().flags
