"""Geoms stay apart: from inside one another, at every length of a step, beside what moves."""

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from matrix import (
    ACCELERATION,
    LIMITS,
    VELOCITY,
    Checked,
    each_backend,
    each_robot,
    problem,
    with_backend,
)
from numpy.typing import NDArray
from obstacles import BALL, WALL, Distances, beside_a_ball

import rmrc
from rmrc import Status

Array = NDArray[np.float64]

D_MIN = 0.002
"""m; less than what there is between the G1's shoulders and its torso."""
PASSED = 1e-6
"""What a distance may be below `d_min`, or below what it was if it was less, m."""
LENGTHS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Lengths of a step, s."""
ASIDE = np.array([0.6, 0.0, -0.8])
"""The direction from the hand in which the obstacles are."""
ABOVE = np.array([0.6, 0.0, 0.8])
ACROSS = np.array([np.sqrt(0.1), 0.0, np.sqrt(0.9), 0.0])
"""The quaternion that turns z into this direction: of a wall across it."""
LOOKS = 10
"""Configurations on the way of a step at which nothing may be inside anything."""
# Pairs that are nearer than `d_min` by the robot's make, or because it stands.
EXCLUDED = {
    "real_panda": [["link0", "link1"]],
    "biped": [["left_foot", "floor"], ["right_foot", "floor"]],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


@cache
def compiled(robot: str, folder: Path, accelerates: bool) -> rmrc.Problem:
    """Return a robot beside a ball and a wall, all of whose pairs are kept apart."""
    collision = {"d_min": D_MIN, "detect": 0.1, "exclude": EXCLUDED.get(robot, [])}
    limits: dict[str, Any] = {**LIMITS, "collision": collision}
    if not accelerates:
        limits["acceleration"] = "off"
    return rmrc.compile(beside_a_ball(robot, folder).config(limits=limits))


@pytest.fixture(params=[True, False], ids=["a_max", "free"])
def made(request: pytest.FixtureRequest, robot: str, backend: str, folder: Path) -> rmrc.Problem:
    return with_backend(compiled(robot, folder, request.param), backend)


class Kept:
    """A controller of a robot beside a ball, whose distances are measured at every step."""

    def __init__(self, problem: rmrc.Problem):
        self.problem, self.checked = problem, Checked(problem)
        self.controller = self.checked.controller
        self.data = self.controller.engine.evaluation.data
        self.distances = Distances(problem)
        self.hand = problem.term["hand"].target[4:].copy()
        self.ball, self.velocity = np.zeros(3), np.zeros(3)
        self.relaxed, self.deepest = 0, 0.0

    def place(self, position: Array, velocity: Array | None = None) -> None:
        """Put the ball somewhere, at rest or moving, m and m/s."""
        self.ball = np.array(position)
        self.velocity = np.zeros(3) if velocity is None else np.array(velocity)
        twist = np.concatenate([self.velocity, np.zeros(3)])
        assert self.controller.set_obstacle(BALL, self.ball, velocity=twist)

    def away(self, name: str) -> float:
        """Return how far the robot is from an obstacle, up to 0.2 m."""
        return float(self.distances.at(self.checked.q, self.data, self.distances.of(name)).min())

    def place_near(self, name: str, distance: float, direction: Array = ASIDE) -> None:
        """Put an obstacle in a direction from the hand, at a distance from the robot."""
        low, high = 0.0, 1.0
        for _ in range(25):
            middle = 0.5 * (low + high)
            assert self.controller.set_obstacle(name, self.hand + middle * direction, ACROSS)
            low, high = (middle, high) if self.away(name) < distance else (low, middle)
        self.ball = self.hand + high * direction
        assert self.controller.set_obstacle(name, self.ball, ACROSS)

    def step(self, dt: float) -> rmrc.Step:
        """Step, and move the ball on; hold every distance to its limit, or to what it was."""
        before = np.minimum(self.distances.at(self.checked.q, self.data), D_MIN)
        step = self.checked.step(self.checked.q, dt)
        if self.velocity.any():
            self.place(self.ball + self.velocity * dt, self.velocity)
        assert step.moment.share == 1.0 or Status.LIMITED in step.flags  # shortened
        lost = before - self.distances.at(step.q, self.data)
        if Status.RELAXED in step.flags:
            self.relaxed += 1
            self.deepest = max(self.deepest, float(lost.max()))
        else:
            assert lost.max() <= PASSED, step
        return step


def way(steps: int, dt: float, made: rmrc.Problem) -> float:
    """Return how far a hand half a metre from its joint comes in some steps from rest, m."""
    rate = np.full(steps, VELOCITY)
    if np.isfinite(made.box.acceleration).any():
        rate = np.minimum(rate, ACCELERATION * dt * np.arange(1, steps + 1))
    return 0.5 * dt * float(rate.sum())


@each_backend
@each_robot
@pytest.mark.parametrize("dt", LENGTHS)
def test_a_ball_in_the_way_is_not_touched(made: rmrc.Problem, dt: float) -> None:
    kept = Kept(made)
    gap = min(0.2 * way(6, dt, made), 0.1)
    kept.place_near(BALL, D_MIN + gap)
    assert kept.controller.set_target("hand", kept.hand + 0.4 * ASIDE)
    nearest = np.inf
    for _ in range(6):
        assert kept.step(dt).status < Status.MAX_ITER
        nearest = min(nearest, kept.away(BALL))
    assert kept.relaxed == 0
    assert nearest < D_MIN + gap


@each_backend
@each_robot
def test_a_thin_wall_is_not_passed_in_a_long_step(made: rmrc.Problem) -> None:
    kept = Kept(made)
    kept.place_near(WALL, 0.03)
    assert kept.controller.set_target("hand", kept.hand + 0.5 * ASIDE)
    pairs = kept.distances.of(WALL)
    for _ in range(6):
        q = kept.checked.q
        step = kept.step(0.1)
        for share in np.linspace(0.0, 1.0, LOOKS + 1):
            between = q.copy()
            mujoco.mj_integratePos(made.model, between, step.v, 0.1 * float(share))
            assert kept.distances.at(between, kept.data, pairs).min() > 0.0
    assert kept.relaxed == 0


@each_backend
@each_robot
def test_what_starts_inside_comes_out(made: rmrc.Problem) -> None:
    kept = Kept(made)
    kept.place_near(BALL, -0.02)  # a finger is not thick enough for that
    inside = start = kept.away(BALL)
    assert start < -0.01
    for _ in range(20):
        step = kept.step(0.02)
        assert step.status < Status.MAX_ITER
        now = kept.away(BALL)
        assert Status.RECOVERING in step.flags or now > D_MIN - PASSED
        assert now >= inside - PASSED or Status.RELAXED in step.flags
        inside = now
    assert inside >= start + 0.01


@each_backend
@each_robot
@pytest.mark.parametrize("speed", [0.1, 1.0, 3.0])
def test_a_ball_that_comes_is_evaded_or_it_says_relaxed(made: rmrc.Problem, speed: float) -> None:
    kept = Kept(made)
    kept.place_near(BALL, D_MIN + min(0.1 * speed, 0.1))
    kept.place(kept.ball, -speed * ASIDE)
    for _ in range(15):
        step = kept.step(0.01)
        # The other solvers do not always certify the least violation, and brake.
        assert step.status < Status.MAX_ITER or made.config.solver.backend != "auto"
    # What is lost is lost to the ball: the robot does not move into it.
    assert kept.deepest <= 0.01 * speed + PASSED


@each_backend
@pytest.mark.parametrize("robot", ["dual_arm", "aloha"])
@pytest.mark.parametrize("dt", [0.002, 0.02])
def test_two_arms_that_are_sent_into_each_other_stay_apart(made: rmrc.Problem, dt: float) -> None:
    kept = Kept(made)
    assert len(kept.distances.pairs) > 1000
    other = made.term["right"].target[4:].copy()
    assert kept.controller.set_target("hand", other)
    assert kept.controller.set_target("right", kept.hand)
    for _ in range(40):
        assert kept.step(dt).status < Status.MAX_ITER
    assert kept.relaxed == 0


@each_backend
@each_robot
def test_random_targets_and_places(made: rmrc.Problem) -> None:
    rng = np.random.default_rng(0)
    kept = Kept(made)
    for k in range(16):
        if k % 8 == 0:
            kept.controller.set_target("hand", kept.hand + rng.uniform(-0.4, 0.4, 3))
            kept.place(kept.hand + rng.uniform(0.25, 0.5, 3) * rng.choice([-1.0, 1.0], 3))
        kept.step(float(rng.choice([0.001, 0.005, 0.02])))


# One near pair does not hold all the others.


@each_backend
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_robot_turns_whose_links_are_always_near(backend: str, side: float) -> None:
    near = {"pairs": "all", "d_min": 0.01}
    limits = {**LIMITS, "collision": near}
    kept = Checked(problem("real_panda", backend, limits=limits))
    target = kept.problem.term["hand"].target[4:]
    assert kept.controller.set_target("hand", target + [0.0, 0.2 * side, 0.0])
    step = [kept.step() for _ in range(20)][-1]
    assert np.abs(step.v).max() > 0.1


@each_backend
@pytest.mark.parametrize("accelerates", [True, False], ids=["a_max", "free"])
def test_a_hand_comes_out_of_a_ball_while_the_robot_stands(
    folder: Path, backend: str, accelerates: bool
) -> None:
    collision = {"d_min": D_MIN, "detect": 0.1}
    limits = {**LIMITS, "collision": collision} | ({} if accelerates else {"acceleration": "off"})
    standing = rmrc.compile(beside_a_ball("biped", folder).config(limits=limits))
    kept = Kept(with_backend(standing, backend))
    kept.place_near(BALL, -0.03, ABOVE)
    start = kept.away(BALL)
    for _ in range(20):
        kept.step(0.02)
    assert kept.away(BALL) > start + 0.01
