"""`STUCK` is of a robot at rest, `failures` counts in a row, and the flags hold all there is."""

from typing import Any

import numpy as np
import pytest
from matrix import DT, LIMITS, ROBOTS, each_backend, each_robot, problem, with_backend
from numpy.typing import NDArray

import rmrc
from rmrc import Status

Array = NDArray[np.float64]

SLOW = 0.01
"""Length of a step in s, for there are many."""
FREE = {**LIMITS, "acceleration": "off"}


REST = 1e-3
"""Largest joint rate of a robot at rest, rad/s."""


def made(robot: str, backend: str = "auto", *tasks: dict[str, Any], **options: Any) -> rmrc.Problem:
    options = {"dt": SLOW, "limits": FREE, **options}
    return with_backend(problem(robot, "auto", *tasks, **options), backend)


def moved(controller: rmrc.Controller, *shift: float) -> Array:
    return controller.problem.term["hand"].target[4:] + shift


def stuck_after(controller: rmrc.Controller, steps: int) -> int | None:
    """Return the number of the first step that says STUCK, or None."""
    for k in range(steps):
        if Status.STUCK in controller.step().flags:
            return k
    return None


@each_backend
@each_robot
def test_a_target_out_of_reach_ends_stuck(robot: str, backend: str) -> None:
    # A base that floats reaches anything; without it the arm does not.
    dofs = {"dofs": ROBOTS[robot].arm} if ROBOTS[robot].arm else {}
    controller = rmrc.Controller(made(robot, backend, ROBOTS[robot].tasks()[0], **dofs))
    # Straight ahead the arm of the G1 creeps for a minute, at 0.02 rad/s: it does not rest.
    away = (0.0, 3.0, 0.0) if robot == "g1" else (3.0, 0.0, 0.0)
    controller.set_target("hand", moved(controller, *away))
    assert stuck_after(controller, 600) is not None
    step = controller.step()
    assert step.status is Status.STUCK
    assert np.abs(step.v).max() <= REST
    assert controller.failures == 0
    # It says so no longer than it is true.
    controller.set_target("hand", moved(controller, 0.0, 0.0, 0.0))
    for _ in range(50):
        step = controller.step()
    assert Status.STUCK not in step.flags


@each_backend
def test_a_robot_that_moves_is_not_stuck(backend: str) -> None:
    # The hand is out of reach, and the rest of the arm turns about it for good.
    turning = {"name": "turn", "type": "velocity", "B": 0.1, "target": {"joint7": 0.05}}
    hand = ROBOTS["panda"].tasks(B=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0])[0]
    controller = rmrc.Controller(made("panda", backend, hand, turning))
    controller.set_target("hand", moved(controller, 3.0, 0.0, 0.0))
    assert stuck_after(controller, 300) is None
    assert controller.step().v[6] > 0.04


@each_backend
@each_robot
@pytest.mark.parametrize(
    "case", ["slow gain", "far and capped", "low acceleration", "turning round", "arrived"]
)
def test_what_gets_on_is_not_stuck(robot: str, backend: str, case: str) -> None:
    shift, tasks, options = (0.03, -0.03, -0.03), ROBOTS[robot].tasks(), {}
    if case == "slow gain":
        tasks[0]["gain"] = 0.02
    elif case == "far and capped":
        shift = (0.1, -0.1, -0.1)
        options["limits"] = {**FREE, "velocity": {"default": 0.01}, "base": {"linear": 0.01}}
    elif case == "low acceleration":
        options["limits"] = {**LIMITS, "acceleration": {"default": 0.02}}
    elif case == "turning round":
        options["limits"] = {**LIMITS, "acceleration": {"default": 0.2}}
    elif case == "arrived":
        shift = (0.0, 0.0, 0.0)
    controller = rmrc.Controller(made(robot, backend, *tasks[:1], tasks[-1], **options))
    if case == "turning round":
        controller.reset(v=_backwards(controller))
    controller.set_target("hand", moved(controller, *shift))
    first = float(controller.step().error["hand"][0])
    assert stuck_after(controller, 100) is None
    last = float(controller.step().error["hand"][0])
    assert last < first or case in ("arrived", "turning round")


def _backwards(controller: rmrc.Controller) -> Array:
    """Return joint rates that take the hand away from where it will be sent."""
    other = rmrc.Controller(controller.problem)
    other.set_target("hand", moved(other, -0.03, 0.03, 0.03))
    v = other.step().v
    return v * (0.15 / float(np.abs(v).max()))


def test_stuck_is_said_within_a_second_and_not_at_once() -> None:
    limits = {
        **FREE,
        "position": {
            f"joint{k}": [q - 1e-4, q + 1e-4] for k, q in enumerate(problem("panda").start, 1)
        },
    }
    held = rmrc.Controller(made("panda", dt=DT, limits=limits))
    held.set_target("hand", moved(held, 0.1, 0.0, 0.0))
    first = stuck_after(held, 500)
    assert first is not None
    assert 0.2 < first * DT < 0.6
    held.reset()
    held.set_target("hand", moved(held, 0.1, 0.0, 0.0))
    assert Status.STUCK not in held.step().flags


@pytest.mark.parametrize("dt", [5e-4, 0.02, 0.1])
def test_stuck_is_a_matter_of_time_not_of_steps(dt: float) -> None:
    start = problem("panda").start
    limits = {
        **FREE,
        "position": {f"joint{k}": [q - 1e-4, q + 1e-4] for k, q in enumerate(start, 1)},
    }
    controller = rmrc.Controller(made("panda", dt=dt, limits=limits))
    controller.set_target("hand", moved(controller, 0.1, 0.0, 0.0))
    first = stuck_after(controller, round(1.0 / dt))
    assert first is not None
    assert 0.2 <= first * dt < 0.6


@each_backend
def test_flags_hold_all_that_is_so(backend: str) -> None:
    limits = {
        **FREE,
        "velocity": {"default": 0.3},
        "position": {"joint4": [-1.4, -0.07]},  # the arm starts at −π/2
        "workspace": [{"frame": {"site": "hand"}, "normal": [0.0, 0.0, 1.0], "offset": 2.0}],
    }
    damping = {"lambda": 0.01, "adapt": "sigma_min", "threshold": 10.0}
    controller = rmrc.Controller(made("panda", backend, limits=limits, damping=damping))
    controller.set_target("hand", moved(controller, 1.0, 0.0, 0.0))
    controller.set_target("hand", [np.nan, 0.0, 0.0])
    step = controller.step()
    assert step.status is Status.INVALID_INPUT
    expected = {Status.INVALID_INPUT, Status.LIMITED, Status.RECOVERING, Status.DAMPED}
    assert expected <= step.flags
    step = controller.step()
    assert step.status is max(step.flags)
    assert step.flags >= expected - {Status.INVALID_INPUT}
    assert Status.INVALID_INPUT not in step.flags
    assert all(step.flag_bits >> status & 1 for status in step.flags)


def test_a_direction_that_is_preserved_says_scaled() -> None:
    hand = ROBOTS["panda"].tasks(preserve="direction")[0]
    controller = rmrc.Controller(made("panda", "auto", hand))
    controller.set_target("hand", moved(controller, 0.3, 0.0, 0.0))
    step = controller.step()
    assert {Status.SCALED, Status.LIMITED} <= step.flags
    assert step.status is Status.SCALED


def test_a_step_without_a_limit_is_ok_and_only_that() -> None:
    controller = rmrc.Controller(made("panda"))
    controller.set_target("hand", moved(controller, 0.01, 0.0, 0.0))
    step = controller.step()
    assert step.flags == {Status.OK}
    assert step.status is Status.OK


def test_every_status_has_advice_of_its_own() -> None:
    advice = [status.advice for status in Status]
    assert len(set(advice)) == len(Status)
    assert all(text.endswith(".") and "\n" not in text for text in advice)


@each_backend
def test_a_target_that_runs_away_is_stuck_only_where_the_robot_is(backend: str) -> None:
    controller = rmrc.Controller(made("panda", backend))
    start = moved(controller, 0.0, 0.0, 0.0)
    for k in range(150):  # it lags behind at a constant distance
        controller.set_target("hand", start + [0.0, 0.002 * k, 0.0])
        assert Status.STUCK not in controller.step().flags
    stuck = []
    for k in range(150):
        controller.set_target("hand", start + [3.0, 0.01 * k, 0.0])
        stuck.append(Status.STUCK in controller.step().flags)
    assert not any(stuck[:20])
