"""The matrix of safety tests, singularities: at, next to and across one, on every backend."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from matrix import ROBOTS, VELOCITY, Checked, each_backend, problem, with_backend
from numpy.typing import NDArray

from rmrc import Problem, Status

Array = NDArray[np.float64]

MILLISECOND = 1e-3  # s
GAIN = 10.0  # 1/s
DAMPING = {"lambda": 0.01, "adapt": "sigma_min", "largest": 0.1}
# A configuration written in 17 digits is this near to the singular one.
EXACT = 1e-14
# Rounding of the program's solution, relative.
RELATIVE = 1e-6
# A joint below this rate, rad/s, 1 % of the path's, is at rest.
REST = 5e-3
WINDOW = 50  # steps, 50 ms
# A joint may turn round on the way in, and once more on the way out.
TURNS = 2
# Largest change of a joint rate in a step of 1 ms on a path of 0.5 rad/s through a singularity,
# rad/s: the most is 0.003.
JUMP = 0.01
# m and rad; the error of a reached target.
REACHED = 1e-3


@dataclass(frozen=True)
class Singularity:
    """Joint values at which the hand's pose loses a direction, and what they need."""

    joints: tuple[str, ...]
    values: tuple[float, ...]
    frame: dict[str, str] | None = None
    """In place of the robot's hand."""
    position: dict[str, tuple[float, float]] | None = None
    """Ranges, where the model's end at the singularity."""


def _panda(prefix: str) -> Singularity:
    half = np.pi / 2.0
    joints = tuple(f"{prefix}joint{k}" for k in range(1, 8))
    return Singularity(joints, (0.3, 0.0, half, -1.5, 0.0, 1.2, 0.4))


SINGULARITIES = {
    "panda": _panda(""),
    "real_panda": _panda(""),
    "dual_arm": _panda("left_"),
    "ur5e": Singularity(
        tuple(
            f"{name}_joint"
            for name in (
                *("shoulder_pan", "shoulder_lift", "elbow"),
                *("wrist_1", "wrist_2", "wrist_3"),
            )
        ),
        (0.2, -1.2, 1.3, -0.6, 0.0, 0.3),
    ),
    "biped": Singularity(
        ROBOTS["biped"].arm or (), (0.3, 0.1, 0.2, 0.0, 0.3, 0.4), position={"left_elbow": (-2, 1)}
    ),
    "g1": Singularity(
        tuple(
            f"left_{name}_joint"
            for name in ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
        ),
        # The straight knee: the root of det J in the angle of the knee, by bisection.
        (-0.3, 0.1, 0.2, -0.3157375124579886, 0.1, 0.05),
        {"body": "left_ankle_roll_link"},
        {"left_knee_joint": (-1.0, 2.5)},
    ),
    "aloha": Singularity(ROBOTS["aloha"].arm or (), (0.3, -0.5, 0.4, 0.3, 0.0, 0.2)),
}
each_singularity = pytest.mark.parametrize("robot", SINGULARITIES)


@lru_cache(maxsize=8)
def _made(robot: str, acceleration: bool, posture: bool) -> Problem:
    singularity = SINGULARITIES[robot]
    hand: dict[str, Any] = {"name": "hand", "type": "frame"}
    hand |= {"frame": singularity.frame or ROBOTS[robot].hand, "axes": "world", "gain": GAIN}
    rest = {"name": "posture", "type": "posture", "B": 0.01, "gain": 1.0}
    limits: dict[str, Any] = {"velocity": {"default": VELOCITY}}
    limits["position"] = singularity.position or {}
    if acceleration:
        limits["acceleration"] = {"default": 50.0}
    return problem(
        robot,
        "auto",
        *([hand, rest] if posture else [hand]),
        dt=MILLISECOND,
        dofs=list(singularity.joints),
        damping=DAMPING,
        limits=limits,
    )


def made(robot: str, backend: str, *, acceleration: bool = False, posture: bool = False) -> Problem:
    """Return the problem of the limb that is singular."""
    return with_backend(_made(robot, acceleration, posture), backend)


def at(made: Problem, robot: str, step: Array | float = 0.0) -> Array:
    """Return the configuration (nq,) a step over the dofs away from the singular one."""
    q = made.start.copy()
    order = np.array([made.model.joint(name).qposadr[0] for name in SINGULARITIES[robot].joints])
    q[order] = SINGULARITIES[robot].values
    q[made.box.coordinate] += step
    return q


def directed(size: int, seed: int = 0) -> Array:
    """Return a random unit vector, none of whose entries is small."""
    rng = np.random.default_rng(seed)
    vector = rng.uniform(0.5, 1.0, size) * rng.choice([-1.0, 1.0], size)
    return vector / np.linalg.norm(vector)


@each_singularity
@each_backend
def test_rates_are_bounded_at_any_distance(robot: str, backend: str) -> None:
    checked = Checked(made(robot, backend))
    assembly = checked.controller.engine.assembly
    away = directed(checked.problem.dofs.size)
    sigmas = []
    for distance in (0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2):
        q = at(checked.problem, robot, distance * away)
        checked.reset(q)
        target = checked.problem.forward(q)["hand"]
        target[:3, 3] += [0.3, -0.2, 0.1]
        checked.aim(target)
        for k in range(3):
            offset = target[:3, 3] - checked.problem.forward(checked.q)["hand"][:3, 3]
            step = checked.step()
            if k == 0:  # later the orientation has an error as well
                bound = GAIN * np.linalg.norm(offset) / (2.0 * assembly.damping)
                assert np.linalg.norm(step.v) <= bound * (1.0 + RELATIVE)
                sigmas.append(assembly.sigma_min())
            assert Status.DAMPED in step.flags
    assert sigmas[0] < EXACT
    assert sigmas[-1] > 1e-6


def path(made: Problem, robot: str, seed: int) -> Array:
    """Return the configurations of a line through the singularity at 0.5 rad/s."""
    direction = 0.5 * directed(made.dofs.size, seed)
    return np.array([at(made, robot, t * direction) for t in np.arange(-60, 61) * MILLISECOND])


def assert_calm(v: Array) -> None:
    """Assert that rates (steps, n) neither jump nor chatter."""
    assert np.abs(np.diff(v, axis=0)).max() < JUMP
    for rate in v.T:
        moving = np.flatnonzero(np.abs(rate) > REST)
        turned = np.zeros(rate.size)
        turned[moving[1:]] = np.diff(np.sign(rate[moving])) != 0.0
        assert np.convolve(turned, np.ones(WINDOW)).max() <= TURNS


@each_singularity
@each_backend
def test_crossing_at_1_khz_is_calm(robot: str, backend: str) -> None:
    checked = Checked(made(robot, backend))
    line = path(checked.problem, robot, seed=0)
    checked.reset(line[0])
    rates = []
    for q in line:
        checked.aim(checked.problem.forward(q)["hand"])
        rates.append(checked.step().v)
    assert_calm(np.array(rates))


@each_singularity
@each_backend
def test_an_arm_that_is_carried_across_is_calm(robot: str, backend: str) -> None:
    # The measured configuration passes the singularity while the target is at the end of its path.
    checked = Checked(made(robot, backend, posture=True))
    line = path(checked.problem, robot, seed=1)
    checked.reset(line[0])
    checked.aim(checked.problem.forward(line[-1])["hand"])
    assert_calm(np.array([checked.step(q).v for q in line]))


@each_singularity
@each_backend
@pytest.mark.parametrize("away", [0.0, -1e-6])
def test_it_leaves_the_singularity_for_its_target(robot: str, backend: str, away: float) -> None:
    checked = Checked(made(robot, backend, acceleration=True))
    size = checked.problem.dofs.size
    checked.reset(at(checked.problem, robot, away * directed(size)))
    there = at(checked.problem, robot, 0.4 * directed(size, seed=2))
    checked.aim(checked.problem.forward(there)["hand"])
    for _ in range(100):
        step = checked.step(dt=0.01)
        assert Status.STUCK not in step.flags
        if step.error["hand"].max() < REACHED:
            return
    pytest.fail("the target is not reached within 1 s")
