"""Programs that are hard to solve, or that there is no time for: a feasible point or the brake."""

import math
from dataclasses import replace
from functools import cache
from statistics import median
from time import thread_time
from typing import Any

import numpy as np
import pytest
from matrix import (
    DT,
    LIMITS,
    ROBOTS,
    ROUNDING,
    Checked,
    each_backend,
    each_robot,
    problem,
    with_backend,
)
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

import rmrc
from braking import left_of
from rmrc import Status
from rmrc.limits.collision import CollisionPairs

Array = NDArray[np.float64]

SHIFT = (0.1, -0.1, 0.1)
"""A shift of the hand's target that brings joints to their limits, m."""
# Two programs with the same optimum, solved to their certificates of 1e-6.
SAME = 2e-5
# Largest residual of a task in a program without damping, m/s.
EXACT = 1e-5
DEADLINE = 1e-3
"""µs, less than a step of any engine needs to evaluate its tasks."""
LATE = 3.0
"""What a step without time may take, in multiples of what it takes to prepare its program."""
ENDING = 150e-6
"""What it may take beyond that, s: the brake, the certificate, the flags, on a busy machine."""


@cache
def compiled(robot: str, kind: str) -> rmrc.Problem:
    make = VARIANTS[kind]
    tasks, options = make(robot)
    return problem(robot, "auto", *tasks, **options)


def hand_alone(robot: str, curvature: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The hand's position is all that is asked for, and nothing picks among the motions."""
    hand = ROBOTS[robot].tasks(B=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0])[0]
    return [hand], {"damping": {"lambda": 0.0, "curvature": curvature}}


def hard_hand(robot: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The hand's task is an equality, beside a posture; near a singularity, too."""
    tasks = ROBOTS[robot].tasks(hard=True)
    return [tasks[0], tasks[-1]], {"damping": {"curvature": "off"}}


def hard_hand_twice(robot: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    tasks, options = hard_hand(robot)
    return [tasks[0], {**tasks[0], "name": "again"}, tasks[1]], options


def planes(robot: str, count: int) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A plane 2 cm above the hand, a number of times over."""
    height = float(problem(robot).term["hand"].target[6]) + 0.02
    below = {"frame": ROBOTS[robot].hand, "normal": [0.0, 0.0, -1.0], "offset": -height}
    return [], {"limits": {**LIMITS, "workspace": [below] * count}}


def pairs(robot: str, count: int) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A pair of bodies that is always near enough to have its row, a number of times over."""
    named = [ROBOTS[robot].pair, ROBOTS[robot].pair[::-1]][:count]
    collision = {"pairs": named, "d_min": 0.01, "detect": 2.0}
    return [], {"limits": {**LIMITS, "collision": collision}}


VARIANTS = {
    "plain": lambda robot: ([], {}),
    "hand alone": lambda robot: hand_alone(robot, "off"),
    "hand alone, with its curvature": lambda robot: hand_alone(robot, "on"),
    "hard": hard_hand,
    "hard twice": hard_hand_twice,
    "plane": lambda robot: planes(robot, 1),
    "plane twice": lambda robot: planes(robot, 2),
    "pair": lambda robot: pairs(robot, 1),
    "pair twice": lambda robot: pairs(robot, 2),
    "rows": lambda robot: ([], {"limits": planes(robot, 1)[1]["limits"] | pair_limit(robot)}),
}


def pair_limit(robot: str) -> dict[str, Any]:
    """Return the collision limit of a pair that has its row."""
    return {"collision": pairs(robot, 1)[1]["limits"]["collision"]}


def aimed(made: rmrc.Problem) -> Checked:
    """Return a controller, whose steps are checked, with a target beside the hand."""
    checked = Checked(made)
    for term in made.terms:
        if term.target_kind == "pose" and term.name in ("hand", "again"):
            assert checked.controller.set_target(term.name, term.target[4:] + SHIFT)
    return checked


def settled(made: rmrc.Problem, **changes: Any) -> rmrc.Problem:
    """Return a problem with other settings of its solver."""
    solver = made.config.solver.model_copy(update=changes)
    deadline = changes.get("deadline", np.inf) * 1e-6
    return replace(
        made, config=made.config.model_copy(update={"solver": solver}), deadline=deadline
    )


@each_backend
@each_robot
def test_a_rank_deficient_hessian(robot: str, backend: str) -> None:
    made = with_backend(compiled(robot, "hand alone"), backend)
    checked = aimed(made)
    for _ in range(15):
        step = checked.step()
        assert step.status < Status.STUCK
        values = np.linalg.eigvalsh(checked.controller.engine.assembly.qp.H)
        assert values[made.dofs.size - 4] < 1e-9 * values[-1] or made.dofs.size < 6
        if step.flags <= {Status.OK}:
            account = step.explain()
            [hand] = [task for task in account.tasks if task.name == "hand"]
            assert hand.got[0] == pytest.approx(hand.asked[0], abs=EXACT)


@each_robot
def test_a_curvature_that_leaves_it_rank_deficient(robot: str) -> None:
    checked = aimed(compiled(robot, "hand alone, with its curvature"))
    for _ in range(15):
        assert checked.step().status < Status.STUCK


@each_backend
@each_robot
@pytest.mark.parametrize("kind", ["hard", "plane", "pair"])
def test_a_row_that_is_there_twice_is_as_one(robot: str, backend: str, kind: str) -> None:
    once = aimed(with_backend(compiled(robot, kind), backend))
    twice = aimed(with_backend(compiled(robot, f"{kind} twice"), backend))
    for _ in range(15):
        q, v = once.q, once.v
        first = once.step()
        assert first.status < Status.STUCK
        # From the same state, so that only this step's difference counts.
        twice.controller.reset(q, v)
        for name in ("hand", "again"):
            if name in twice.problem.term:
                twice.controller.set_target(name, once.problem.term["hand"].target[4:] + SHIFT)
        second = twice.controller.step(q)
        assert second.flags == first.flags
        np.testing.assert_allclose(second.v, first.v, rtol=0.0, atol=SAME)


@each_backend
@each_robot
@pytest.mark.parametrize("kind", ["hard", "hard twice"])
def test_a_hard_task_that_is_too_fast_is_missed_by_the_least(
    robot: str, backend: str, kind: str
) -> None:
    checked = aimed(with_backend(compiled(robot, kind), backend))
    controller, dofs = checked.controller, checked.problem.dofs
    for _ in range(15):
        step = checked.step()
        q, before = step.moment.q, step.moment.v_previous
        controller.engine.prepare(q, before, DT)
        qp = controller.engine.assembly.qp
        least = lsq_linear(qp.E, qp.f, (qp.lb - ROUNDING, qp.ub + ROUNDING), method="bvls")
        missed = np.linalg.norm(qp.E @ step.v[dofs] - qp.f)
        assert missed <= math.sqrt(2.0 * least.cost) + SAME
        assert (Status.RELAXED in step.flags) == (missed > SAME)


@each_robot
def test_a_pair_that_is_named_twice_is_one_pair(robot: str) -> None:
    count = {
        kind: [
            len(b.geoms) for b in compiled(robot, kind).barriers if isinstance(b, CollisionPairs)
        ]
        for kind in ("pair", "pair twice")
    }
    assert count["pair"] == count["pair twice"]


@each_backend
@each_robot
@pytest.mark.parametrize("kind", ["plain", "rows"])
def test_one_iteration_gives_a_feasible_point_or_brakes(
    robot: str, backend: str, kind: str
) -> None:
    made = settled(with_backend(compiled(robot, kind), backend), max_iter=1)
    checked = aimed(made)
    failures = failed = 0
    for _ in range(15):
        step = checked.step()  # which holds it to the box
        account = step.solution
        assert account.iterations <= 1
        failures = failures + 1 if Status.MAX_ITER in step.flags else 0
        failed += Status.MAX_ITER in step.flags
        assert checked.controller.failures == failures
        qp = checked.controller.engine.assembly.qp
        if qp.lo.size and Status.RELAXED not in step.flags:
            activity = qp.C @ step.v[made.dofs]
            assert (activity >= qp.lo - SAME).all()
            assert (activity <= qp.hi + SAME).all()
    assert failed or backend != "auto"


@each_backend
@each_robot
@pytest.mark.parametrize("kind", ["plain", "rows"])
def test_a_deadline_is_kept_by_braking(robot: str, backend: str, kind: str) -> None:
    made = with_backend(compiled(robot, kind), backend)
    if (
        backend != "auto"
    ):  # the ladder of a backend that is named is Python's, beside a C++ `prepare`
        config = made.config.model_copy(update={"engine": "python"})
        made = replace(made, config=config)
    moving = aimed(made)
    for _ in range(20):
        moving.step()
    checked = aimed(settled(made, deadline=DEADLINE))
    checked.reset(moving.q, moving.v)
    engine, prepared, took = checked.controller.engine, [], []
    for count in range(1, 41):
        before = checked.v
        begun = thread_time()
        engine.prepare(checked.q, checked.v, DT)
        prepared.append(thread_time() - begun)
        begun = thread_time()
        step = checked.controller.step()
        took.append(thread_time() - begun)
        checked._check(step, checked.q, DT)
        checked.q, checked.v = step.q.copy(), step.v.copy()
        assert step.status is Status.DEADLINE
        assert checked.controller.failures == count
        lb, ub = engine.assembly.qp.lb, engine.assembly.qp.ub
        brake = left_of(before[made.dofs], made.box.acceleration * DT).clip(lb, ub)
        np.testing.assert_allclose(step.v[made.dofs], brake, rtol=0.0, atol=ROUNDING)
        assert np.abs(step.v).max() <= np.abs(before).max() + ROUNDING
    assert median(took) <= LATE * median(prepared) + ENDING


@each_backend
@each_robot
def test_a_deadline_that_is_long_enough_changes_nothing(robot: str, backend: str) -> None:
    made = with_backend(compiled(robot, "rows"), backend)
    checked, twin = aimed(settled(made, deadline=1e6)), aimed(made)
    for count in range(10):
        first, second = checked.step(), twin.step()
        if backend == "proxqp" and count == 0:  # its pace is not known yet
            checked.reset(twin.q, twin.v)
            assert checked.controller.set_target("hand", made.term["hand"].target[4:] + SHIFT)
            continue
        assert first.flags == second.flags
        np.testing.assert_array_equal(first.v, second.v)
        assert checked.controller.failures == 0


@each_backend
def test_failures_are_counted_in_a_row(backend: str) -> None:
    controller = rmrc.Controller(with_backend(compiled("panda", "plain"), backend))
    bad = np.full(7, np.nan)
    counts = []
    for q in (None, bad, bad, None, bad, None, None):
        controller.step(q)
        counts.append(controller.failures)
    assert counts == [0, 1, 2, 0, 1, 0, 0]
    controller.step(bad)
    controller.reset()
    assert controller.failures == 0
    controller.set_target("hand", [np.nan, 0.0, 0.0])
    assert Status.INVALID_INPUT in controller.step().flags
    assert controller.failures == 1
