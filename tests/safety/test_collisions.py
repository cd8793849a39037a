"""Geoms stay apart: from inside one another, at every length of a step, beside what moves."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix import ACCELERATION, LIMITS, VELOCITY, Checked, each_backend, each_robot, with_backend
from numpy.typing import NDArray
from obstacles import BALL, Distances, beside_a_ball

import rmrc
from rmrc import Status

Array = NDArray[np.float64]

D_MIN = 0.01
"""m."""
PASSED = 1e-6
"""What a distance may be below `d_min`, m."""
LENGTHS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Lengths of a step, s."""
# What a pair that starts too near may lose in a step to rounding on its way apart, m.
ROUNDING = 1e-7
FREE = {"acceleration": "off"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


@cache
def compiled(robot: str, folder: Path, accelerates: bool, pairs: Any = "all") -> rmrc.Problem:
    """Return a robot beside a ball, whose pairs are kept apart."""
    collision = {"pairs": pairs, "d_min": D_MIN, "detect": 0.1}
    limits = {**LIMITS, **({} if accelerates else FREE), "collision": collision}
    return rmrc.compile(beside_a_ball(robot, folder).config(limits=limits))


@pytest.fixture(params=[True, False], ids=["a_max", "free"])
def made(request: pytest.FixtureRequest, robot: str, backend: str, folder: Path) -> rmrc.Problem:
    return with_backend(compiled(robot, folder, request.param), backend)


class Kept:
    """A controller of a robot beside a ball, whose distances are measured at every step."""

    def __init__(self, problem: rmrc.Problem):
        self.problem, self.checked = problem, Checked(problem)
        self.controller = self.checked.controller
        self.distances = Distances(problem)
        self.hand = problem.term["hand"].target[4:].copy()
        self.ball, self.velocity = np.array([0.0, 0.0, 10.0]), np.zeros(3)
        self.relaxed = 0
        self.deepest = 0.0
        self.nearest = np.inf

    def measure(self, q: Array) -> Array:
        obstacles = self.controller.engine.evaluation.data.mocap_pos.copy()
        mocap = int(self.problem.model.body(BALL).mocapid[0])
        obstacles[mocap] = self.ball
        return self.distances.at(q, obstacles)

    def place(self, position: Array, velocity: Array | None = None) -> None:
        """Put the ball somewhere, at rest or moving, m and m/s."""
        self.ball = np.array(position)
        self.velocity = np.zeros(3) if velocity is None else np.array(velocity)
        twist = np.concatenate([self.velocity, np.zeros(3)])
        assert self.controller.set_obstacle(BALL, self.ball, velocity=twist)

    def step(self, dt: float) -> rmrc.Step:
        """Step, and move the ball on; hold every distance to its limit, or to what it was."""
        before = np.minimum(self.measure(self.checked.q), D_MIN)
        step = self.checked.step(self.checked.q, dt)
        self.place(self.ball + self.velocity * dt, self.velocity)
        after = self.measure(step.q)
        self.nearest = min(self.nearest, float(after.min()))
        if Status.RELAXED in step.flags:
            self.relaxed += 1
            self.deepest = max(self.deepest, float((before - after).max()))
        else:
            lost = before - after
            assert lost.max() <= PASSED, (lost.max(), after.min(), step.flags)
        return step

    def ball_distance(self) -> float:
        """Return how far the robot is from the ball, up to 0.2 m."""
        geom = self.problem.model.geom(BALL).id
        pairs = (self.distances.pairs == geom).any(axis=1)
        return float(self.measure(self.checked.q)[pairs].min())

    def place_near(self, direction: Array, distance: float) -> None:
        """Put the ball at a distance from the robot, from the hand on in a direction."""
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            self.place(self.hand + middle * direction)
            low, high = (middle, high) if self.ball_distance() < distance else (low, middle)
        self.place(self.hand + high * direction)


ASIDE = np.array([0.6, 0.0, 0.8])
"""The direction from the hand in which the ball is."""


def way(steps: int, dt: float, accelerates: bool) -> float:
    """Return how far a hand half a metre from its joint comes in some steps from rest, m."""
    count = np.arange(1, steps + 1)
    rate = np.minimum(ACCELERATION * dt * count, VELOCITY) if accelerates else VELOCITY
    return 0.5 * dt * float(np.broadcast_to(rate, steps).sum())


@each_backend
@each_robot
@pytest.mark.parametrize("dt", LENGTHS)
def test_a_ball_in_the_way_is_not_touched(made: rmrc.Problem, dt: float) -> None:
    kept = Kept(made)
    gap = min(0.2 * way(12, dt, bool(np.isfinite(made.box.acceleration).any())), 0.1)
    kept.place_near(ASIDE, D_MIN + gap)
    assert kept.controller.set_target("hand", kept.hand + 0.4 * ASIDE)
    for _ in range(12):
        assert kept.step(dt).status < Status.MAX_ITER
    assert kept.relaxed == 0
    assert kept.ball_distance() < D_MIN + 0.9 * gap


@each_backend
@each_robot
def test_what_starts_inside_comes_out(made: rmrc.Problem) -> None:
    kept = Kept(made)
    kept.place_near(ASIDE, -0.03)
    inside = kept.ball_distance()
    assert inside < -0.02
    for _ in range(40):
        step = kept.step(0.02)
        assert step.status < Status.MAX_ITER
        assert Status.RECOVERING in step.flags or kept.ball_distance() > D_MIN - PASSED
        assert kept.ball_distance() >= inside - ROUNDING
        inside = kept.ball_distance()
    assert inside >= D_MIN - PASSED


@each_backend
@each_robot
@pytest.mark.parametrize("speed", [0.05, 0.3, 1.0, 3.0])
def test_a_ball_that_comes_is_evaded_or_it_says_relaxed(made: rmrc.Problem, speed: float) -> None:
    kept = Kept(made)
    kept.place_near(ASIDE, D_MIN + 0.1)
    kept.place(kept.ball, -speed * ASIDE)
    for _ in range(30):
        assert kept.step(0.01).status < Status.MAX_ITER


@each_backend
@pytest.mark.parametrize("robot", ["dual_arm", "aloha"])
@pytest.mark.parametrize("dt", [0.002, 0.02])
def test_two_arms_that_are_sent_into_each_other_stay_apart(made: rmrc.Problem, dt: float) -> None:
    kept = Kept(made)
    assert len(kept.distances.pairs) > 1000
    other = made.term["right"].target[4:].copy()
    assert kept.controller.set_target("hand", other)
    assert kept.controller.set_target("right", kept.hand)
    for _ in range(60):
        assert kept.step(dt).status < Status.MAX_ITER
    assert kept.relaxed == 0


@each_backend
@each_robot
def test_random_targets_for_all_pairs(made: rmrc.Problem) -> None:
    rng = np.random.default_rng(0)
    kept = Kept(made)
    for k in range(60):
        if k % 15 == 0:
            kept.controller.set_target("hand", kept.hand + rng.uniform(-0.4, 0.4, 3))
            kept.place(kept.hand + rng.uniform(0.25, 0.5, 3) * rng.choice([-1.0, 1.0], 3))
        assert kept.step(float(rng.choice([0.001, 0.005, 0.02]))).status < Status.MAX_ITER
