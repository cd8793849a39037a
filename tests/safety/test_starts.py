"""The matrix of safety tests, starts: at a limit, outside of it, and inside an obstacle."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from matrix import (
    LIMITS,
    ROBOTS,
    ROUNDING,
    VELOCITY,
    Checked,
    each_backend,
    each_robot,
    problem,
    with_backend,
)
from numpy.typing import NDArray

from rmrc import Problem, Status
from rmrc.engine.python import PythonEngine
from rmrc.model.extents import FINEST as PASSED

Array = NDArray[np.float64]

LONG = 0.02  # s
# A joint that is 1 rad outside has returned at 2 rad/s and 15 rad/s² after less than this.
RETURNED = 50  # steps
DEPTH = 0.02  # m, of an overlap
PUSH = 0.1  # m/s
# Steps in which an overlap is pushed apart, and d_min = 0.01 m besides.
APART = 60


@lru_cache(maxsize=8)
def _made(robot: str) -> Problem:
    # Fingers that are coupled cannot be anywhere in their ranges.
    return problem(robot, dt=LONG, equalities="off")


def displaced(made: Problem, distance: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the start with every other joint that has a range a distance beyond its end."""
    box, q = made.box, made.start.copy()
    moved = np.flatnonzero(np.isfinite(box.lower))[::2]
    place = box.coordinate[moved]
    upper = np.random.default_rng(0).integers(2, size=moved.size) == 1
    q[place] = np.where(upper, box.upper[moved] + distance, box.lower[moved] - distance)
    return q, moved


@each_robot
@each_backend
def test_at_its_limits_a_robot_is_inside(robot: str, backend: str) -> None:
    made = with_backend(_made(robot), backend)
    q, _ = displaced(made, 0.0)
    checked = Checked(made, q)
    hand = made.forward(q)["hand"]
    hand[:3, 3] += [0.2, -0.1, 0.2]
    checked.aim(hand)
    for _ in range(10):
        flags = checked.step().flags
        assert not flags & {Status.RECOVERING, Status.MAX_ITER, Status.RELAXED}


@each_robot
@each_backend
@pytest.mark.parametrize("distance", [1e-9, 1e-3, 0.1, 1.0])
def test_from_outside_it_returns_monotonically(robot: str, backend: str, distance: float) -> None:
    made = with_backend(_made(robot), backend)
    q, moved = displaced(made, distance)
    checked = Checked(made, q)
    outside, fastest = checked.outside(q), 0.0
    assert outside[moved] == pytest.approx(distance, rel=1e-6)
    for _ in range(RETURNED):
        step = checked.step()
        assert not step.flags & {Status.MAX_ITER, Status.RELAXED}
        if outside.max() > 2.0 * ROUNDING:
            assert Status.RECOVERING in step.flags
        now = checked.outside(checked.q)
        assert (now <= outside + ROUNDING).all()
        outside, fastest = now, max(fastest, float(np.abs(step.v[made.dofs[moved]]).max()))
    assert outside.max() <= ROUNDING
    assert Status.RECOVERING not in checked.step().flags
    if distance == 1.0:
        assert fastest == pytest.approx(VELOCITY)


@lru_cache(maxsize=8)
def _with_obstacle(robot: str) -> tuple[Problem, Array]:
    """Return a problem with collision limits and a configuration in which the two parts overlap.

    It is found by going down the slope of the least distance.
    """
    collision: dict[str, Any] = {"pairs": [ROBOTS[robot].pair], "push": PUSH}
    far = problem(robot, dt=LONG, limits={**LIMITS, "collision": {**collision, "detect": 5.0}})
    engine, box, q = PythonEngine(far), far.box, far.start.copy()
    hinges = np.isfinite(box.lower)
    place = box.coordinate[hinges]
    for _ in range(500):
        engine.prepare(q, np.zeros(far.model.nv), LONG)
        near = engine.rows.blocks[0].near
        nearest = int(np.argmin(near.distance))
        room = near.distance[nearest] + DEPTH
        if room < 0.0:
            break
        slope = near.slope[nearest][far.dofs[hinges]]
        q[place] -= slope * min(room + 0.001, 0.02) / (slope @ slope)
        q[place] = np.clip(q[place], box.lower[hinges], box.upper[hinges])
    else:
        raise AssertionError("the two parts do not come together")
    return problem(robot, dt=LONG, limits={**LIMITS, "collision": collision}), q


@each_robot
@each_backend
def test_inside_an_obstacle_it_is_pushed_out(robot: str, backend: str) -> None:
    made, q = _with_obstacle(robot)
    checked = Checked(with_backend(made, backend), q)
    engine = checked.controller.engine
    barrier, pairs = engine.rows.barriers[0], np.arange(len(made.barriers[0].geoms))  # type: ignore
    distances = []
    for _ in range(APART):
        step = checked.step()
        distances.append(barrier.distances(engine.evaluation.data, pairs).min())
        assert Status.MAX_ITER not in step.flags
        assert (Status.RECOVERING in step.flags) == (distances[-1] < -PASSED)
    passed = np.array(distances) < -PASSED
    assert distances[0] < -0.5 * DEPTH
    assert np.diff(distances)[passed[:-1]].min() > -PASSED
    assert not passed[np.argmin(passed) :].any()
    assert not passed[-1]


@each_robot
def test_the_distance_that_is_recorded_is_not_below_the_limit_when_none_is(robot: str) -> None:
    made, q = _with_obstacle(robot)
    checked = Checked(made, q)
    engine = checked.controller.engine
    barrier, pairs = engine.rows.barriers[0], np.arange(len(made.barriers[0].geoms))  # type: ignore
    for _ in range(APART):
        checked.step()
        data = engine.evaluation.data
        true, least = barrier.distances(data, pairs).min(), barrier.least(data)[0]
        assert least <= true + ROUNDING
        assert least >= min(true, made.barriers[0].detect - 0.01) - ROUNDING  # type: ignore
