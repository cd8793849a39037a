"""The matrix of safety tests, targets: at the end of the reach, beyond it, and turned around."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
import pytest
from matrix import ROBOTS, Checked, each_backend, each_robot, problem, with_backend
from numpy.typing import NDArray

from rmrc import Problem, Status

Array = NDArray[np.float64]

LONG = 0.01  # s
MOST_STEPS = 600  # 6 s
# The steps of a quarter of a second, in which a robot that stands still must show it.
WINDOW = 25
# Largest rate of a robot that has settled, rad/s, and how far its error then still falls, m or rad.
REST, STILL = 0.05, 2e-3
# The end of the reach is singular: the error falls as 1/t there, and this is left of it, m.
END = 5e-3
# What a robot that is not stuck gets nearer in the window, m or rad.
ON = 1e-5
# What `converged` means by default, m and rad.
TOLERANCE = np.array([1e-3, 1e-2])
# What two computations of the same thing may differ by, rad/s.
ROUNDING = 1e-9


@lru_cache(maxsize=2)
def _made(robot: str, orientation: float, posture: bool) -> Problem:
    """Return the problem of the arm alone, whose hand is asked for its place or its pose."""
    tasks = ROBOTS[robot].tasks(B={"position": 1.0, "orientation": orientation})
    options: dict[str, Any] = {"dt": LONG, "dofs": ROBOTS[robot].arm}
    options["damping"] = {"adapt": "sigma_min"}
    return problem(robot, "auto", tasks[0], *([tasks[-1]] if posture else []), **options)


@dataclass(frozen=True)
class History:
    """What happened on the way to a target."""

    error: Array
    """Of the hand (steps, 1 or 2), m and rad."""
    rate: Array
    """Largest joint rate (steps,)."""
    stuck: Array
    """Whether STUCK was reported (steps,)."""

    @property
    def calm(self) -> bool:
        """Whether it had settled at the end."""
        left = np.abs(self.error[-WINDOW:] - self.error[-1]).max()
        return bool(self.rate[-WINDOW:].max() < REST and left < STILL)

    @property
    def nearing(self) -> bool:
        """Whether the robot still gets nearer."""
        return bool((self.error[-WINDOW] - self.error[-1]).max() > ON)

    @property
    def slowing(self) -> bool:
        """Whether the robot still comes to rest: what a lower task asks for decays at its rate."""
        return bool(self.rate[-1] < self.rate[-WINDOW])

    @property
    def reached(self) -> bool:
        """Whether the target was reached at the end."""
        return bool((self.error[-1] < TOLERANCE[: self.error.shape[1]]).all())


def approach(checked: Checked) -> History:
    """Step until the robot has settled."""
    errors, rates, stuck = [], [], []
    while True:
        step = checked.step()
        errors.append(step.error["hand"])
        rates.append(np.abs(step.v).max())
        stuck.append(Status.STUCK in step.flags)
        history = History(np.array(errors), np.array(rates), np.array(stuck))
        settled = len(errors) > WINDOW and (stuck[-1] or history.reached) and history.calm
        if settled or len(errors) == MOST_STEPS:
            return history


@lru_cache(maxsize=8)
def reach(robot: str) -> tuple[Array, Array]:
    """Return the shoulder (3,) and the furthest place (3,) of the hand, outward from its start."""
    made = _made(robot, 0.0, posture=False)
    data = mujoco.MjData(made.model)
    data.qpos[:] = made.start
    mujoco.mj_kinematics(made.model, data)
    shoulder = data.xanchor[made.model.dof_jntid[made.dofs[0]]].copy()
    checked = Checked(made)
    for _ in range(4):  # a little further each time, so that the arm comes to rest
        hand = made.forward(checked.q)["hand"]
        hand[:3, 3] += 0.4 * (hand[:3, 3] - shoulder)
        checked.aim(hand)
        approach(checked)
    assert approach(checked).calm
    return shoulder, made.forward(checked.q)["hand"][:3, 3]


def aimed(robot: str, backend: str, share: float, posture: bool) -> Checked:
    """Return an arm whose target is at a share of its reach."""
    shoulder, end = reach(robot)
    checked = Checked(with_backend(_made(robot, 0.0, posture), backend))
    target = checked.problem.forward(checked.q)["hand"]
    target[:3, 3] = shoulder + share * (end - shoulder)
    checked.aim(target)
    return checked


@each_robot
@each_backend
def test_the_end_of_the_reach_is_reached(robot: str, backend: str) -> None:
    history = approach(aimed(robot, backend, 1.0, posture=False))
    assert history.calm
    assert history.error[-1, 0] < END
    assert not history.stuck.any()


@each_robot
@each_backend
@pytest.mark.parametrize("case", ["beyond", "10 times", "1e6 m"])
def test_beyond_the_reach_it_settles(robot: str, backend: str, case: str) -> None:
    length = float(np.linalg.norm(np.subtract(*reach(robot))))
    share = {"beyond": 1.01, "10 times": 10.0, "1e6 m": 1e6 / length}[case]
    history = approach(aimed(robot, backend, share, posture=True))
    assert history.rate.max() > REST
    assert history.calm
    assert (
        not history.stuck.any()
        or history.error[np.argmax(history.stuck)] - history.error[-1] < STILL
    )


@each_robot
@each_backend
@pytest.mark.parametrize("past", [-1e-9, 0.0, 1e-9])
def test_a_target_turned_by_180_degrees(robot: str, backend: str, past: float) -> None:
    checked = Checked(with_backend(_made(robot, 1.0, posture=True), backend))
    target = checked.problem.forward(checked.q)["hand"]
    turn, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(turn, target[:3, 2], np.pi + past)
    mujoco.mju_quat2Mat(matrix, turn)
    target[:3, :3] = matrix.reshape(3, 3) @ target[:3, :3]
    checked.aim(target)
    history = approach(checked)
    assert history.error[0, 1] == pytest.approx(np.pi, abs=1e-8)
    assert history.error[-1, 1] < 0.1 * np.pi
    assert history.reached or history.stuck[-1] or history.nearing or history.slowing
    assert history.calm


@each_robot
@each_backend
def test_both_signs_of_a_quaternion_are_the_same_target(robot: str, backend: str) -> None:
    made = with_backend(_made(robot, 1.0, posture=True), backend)
    one, other = Checked(made), Checked(made)
    quaternion = np.random.default_rng(0).normal(size=4)
    for k in range(20):
        assert one.controller.set_target("hand", quaternion=quaternion)
        assert other.controller.set_target("hand", quaternion=(-1.0) ** k * quaternion)
        assert np.abs(one.step().v - other.step().v).max() < ROUNDING
