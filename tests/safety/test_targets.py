"""The matrix of safety tests, targets: at the end of the reach, beyond it, and turned around."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from matrix import LIMITS, ROBOTS, Checked, each_backend, each_robot, problem, with_backend
from rmrc import Problem, Status

Array = NDArray[np.float64]

LONG = 0.01  # s, of a step: what is far away does not need a shorter one
MOST_STEPS = 400  # 4 s
# The steps of a quarter of a second, in which a robot that stands still must show it.
WINDOW = 25
# Largest rate of a robot that has settled, rad/s, and how far its error then still falls, m or rad.
REST, STILL = 0.05, 2e-3
# What `converged` means by default, m and rad.
TOLERANCE = np.array([1e-3, 1e-2])
POSITION = {"position": 1.0, "orientation": 0.0}
ORIENTATION = {"position": 0.0, "orientation": 1.0}


@lru_cache(maxsize=4)
def _made(robot: str, weight: tuple[float, float], acceleration: bool = True) -> Problem:
    """Return the problem of the arm alone, whose hand is asked for its position or its pose."""
    position, orientation = weight
    tasks = ROBOTS[robot].tasks(B={"position": position, "orientation": orientation})
    options: dict[str, Any] = {"dt": LONG, "dofs": ROBOTS[robot].arm, "limits": LIMITS}
    options["damping"] = {"adapt": "sigma_min"}
    return problem(robot, "daqp", tasks[0], **options)


@dataclass(frozen=True)
class History:
    """What happened on the way to a target."""

    error: Array
    """Of the hand (steps, 1 or 2)."""
    rate: Array
    """Largest joint rate (steps,)."""
    stuck: Array
    """Whether STUCK was reported (steps,)."""

    @property
    def calm(self) -> bool:
        """Whether it had settled at the end."""
        left = np.abs(self.error[-WINDOW:] - self.error[-1]).max()
        return bool(self.rate[-WINDOW:].max() < REST and left < STILL)


def approach(checked: Checked, most: int = MOST_STEPS) -> History:
    """Step until the robot has settled."""
    errors, rates, stuck = [], [], []
    for _ in range(most):
        step = checked.step()
        errors.append(step.error["hand"])
        rates.append(np.abs(step.v).max())
        stuck.append(Status.STUCK in step.flags)
        history = History(np.array(errors), np.array(rates), np.array(stuck))
        if len(errors) > WINDOW and history.calm and (
            stuck[-1] or (errors[-1] < TOLERANCE[: errors[-1].size]).all()
        ):
            break
    return history


@lru_cache(maxsize=8)
def reach(robot: str) -> tuple[Array, Array]:
    """Return the shoulder (3,) and the furthest place (3,) of the hand, outward from its start."""
    made = _made(robot, (1.0, 0.0))
    shoulder_joint = made.model.dof_jntid[made.dofs[0]]
    data = mujoco.MjData(made.model)
    data.qpos[:] = made.start
    mujoco.mj_kinematics(made.model, data)
    shoulder = data.xanchor[shoulder_joint].copy()
    checked = Checked(made)
    for _ in range(4):  # a little further each time, so that the arm comes to rest
        hand = checked.problem.forward(checked.q)["hand"]
        hand[:3, 3] += 0.4 * (hand[:3, 3] - shoulder)
        checked.aim(hand)
        history = approach(checked)
    assert history.calm
    return shoulder, checked.problem.forward(checked.q)["hand"][:3, 3]


@each_robot
@each_backend
@pytest.mark.parametrize("case", ["at", "beyond", "10 times", "1e6 m"])
def test_the_end_of_the_reach(robot: str, backend: str, case: str) -> None:
    shoulder, end = reach(robot)
    arm = end - shoulder
    length = float(np.linalg.norm(arm))
    share = {"at": 1.0, "beyond": 1.01, "10 times": 10.0, "1e6 m": 1e6 / length}[case]
    checked = Checked(with_backend(_made(robot, (1.0, 0.0)), backend))
    target = checked.problem.forward(checked.q)["hand"]
    target[:3, 3] = shoulder + share * arm
    checked.aim(target)
    history = approach(checked)
    print("REACH", robot, backend, case, len(history.error), history.error[-1], history.rate[-WINDOW:].max(), history.stuck[-1])
    assert history.rate.max() > REST
    assert history.calm
    if case == "at":
        assert history.error[-1, 0] < TOLERANCE[0] 
        assert not history.stuck.any()
    else:
        assert history.stuck[-1]
        assert history.error[history.stuck][0] - history.error[-1] < STILL


@each_robot
@each_backend
@pytest.mark.parametrize("past", [-1e-9, 0.0, 1e-9])
def test_a_target_turned_by_180_degrees(robot: str, backend: str, past: float) -> None:
    checked = Checked(with_backend(_made(robot, (1.0, 1.0)), backend))
    target = checked.problem.forward(checked.q)["hand"]
    turn, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(turn, target[:3, 2], np.pi + past)
    mujoco.mju_quat2Mat(matrix, turn)
    target[:3, :3] = matrix.reshape(3, 3) @ target[:3, :3]
    checked.aim(target)
    history = approach(checked)
    print("TURN", robot, backend, past, len(history.error), history.error[0], history.error[-1], history.rate[-WINDOW:].max(), history.stuck[-1])
    assert history.error[0, 1] == pytest.approx(np.pi, abs=1e-8)
    assert history.calm
    assert history.stuck[-1] or (history.error[-1] < TOLERANCE).all()


@each_robot
@each_backend
def test_both_signs_of_a_quaternion_are_the_same_target(robot: str, backend: str) -> None:
    made = with_backend(_made(robot, (1.0, 1.0)), backend)
    one, other = Checked(made), Checked(made)
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=4)
    for k in range(20):
        assert one.controller.set_target("hand", quaternion=quaternion)
        assert other.controller.set_target("hand", quaternion=(-1.0) ** k * quaternion)
        assert np.abs(one.step().v - other.step().v).max() < 1e-9
