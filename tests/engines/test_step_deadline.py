"""The time that a whole step may use: kept wherever the step is, and what it ends with."""

import gc
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from braking import left_of
from models import REPOSITORY, config
from rmrc import Controller, Problem, Status
from rmrc.limits.collision import CollisionPairs
from rmrc.qp.relax import least_violation
from rmrc.runs.check import check
from slow_steps import Place, problem, walk

Array = NDArray[np.float64]

pytest.importorskip(
    "rmrc._native", reason="the native extension is not built", exc_type=ImportError
)

DEADLINE = 900e-6
"""s."""
STEPS, PASSES, RUNGS = 100, 4, 6
"""A step is slow by itself if it is slow in each of the passes, which other processes are not."""
BESIDE = 150e-6
"""s: what Python adds to a step, the kinematics before it, and a cache that others have used."""
MOST = {"panda": 1.2e-3, "panda, stopping": 1.2e-3, "panda, strict": 1.2e-3, "chain": 3e-3}
"""s: the whole step of the Panda and of the chain, whatever its rows take."""
QUICK = 3e-3
"""s: of steps without a deadline that were 43 to 78 ms before the ladder came to C++."""
KEPT = 1e-6
"""m; `rmrc.model.extents.FINEST`."""
ROUNDING = 1e-12
MOVED = 0.03
"""rad, of the joint that is moved most."""
LOST = 2e-5
"""m: 1,200 steps may take off 1e-9 m each, and once what is measured of a mesh jumps by."""


@pytest.fixture(autouse=True)
def _without_collector() -> Iterator[None]:
    """Have no garbage collected inside a step."""
    gc.disable()
    yield
    gc.enable()


def least_times(made: Problem, places: list[Place]) -> tuple[Array, Array]:
    """Return the least times of each step and of evaluating its rows, of the thread's own, s."""
    steps, rows = np.full((2, len(places)), np.inf)
    controller, clock = Controller(made, "native"), time.thread_time
    engine: Any = Controller(made, "native").engine
    for _ in range(PASSES):
        controller.reset()
        for k, place in enumerate(places):
            for name, target in place.targets.items():
                assert controller.set_target(name, *target)
            begin = clock()
            controller.step(place.q)
            steps[k] = min(steps[k], clock() - begin)
            engine._assemble(place.q, made.dt)
            qp = engine._assembly.qp
            begin = clock()
            engine._rows.native.update(qp.lb, qp.ub, made.dt)
            rows[k] = min(rows[k], clock() - begin)
    return steps, rows


@pytest.mark.parametrize(
    "case",
    ["panda", "panda, stopping", "panda, strict", "g1", "g1, strict", "aloha", "aloha, stopping"],
)
def test_no_step_of_a_robot_is_late(case: str, menagerie: Path, tmp_path: Path) -> None:
    made = problem(case, tmp_path, 1e6 * DEADLINE)
    steps, rows = least_times(made, list(walk(made, STEPS)))
    assert (steps <= DEADLINE + 2.0 * rows + BESIDE).all()
    assert steps.max() <= MOST.get(case, np.inf)


def test_no_step_of_a_chain_is_late(tmp_path: Path) -> None:
    made = problem("chain", tmp_path, 1e6 * DEADLINE)
    steps, rows = least_times(made, list(walk(made, STEPS)))
    assert (steps <= DEADLINE + 2.0 * rows + BESIDE).all()
    assert steps.max() <= MOST["chain"]


def test_the_python_engine_goes_to_no_rung_when_its_time_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It cannot be on time, but begins nothing more; with time it goes down the ladder.

    With the curvature the hard tasks that cannot hold are a cost, and no rung is needed.
    """
    taken: list[str] = []

    def counted(qp: Any, brake: Any, allow: Any) -> Any:
        taken.append("rung")
        return least_violation(qp, brake, allow)

    monkeypatch.setattr("rmrc.engine.python.least_violation", counted)
    made = replace(problem("chain", tmp_path, 1e6 * DEADLINE), curvature=False)
    for deadline, goes in ((np.inf, True), (DEADLINE, False)):
        taken.clear()
        controller = Controller(replace(made, deadline=deadline), "python")
        for place in walk(made, RUNGS):
            step = controller.step(place.q)
            assert (Status.DEADLINE in step.flags) == (not goes)
        assert bool(taken) == goes


# What a step ends with whose time is over.


def least_distance(made: Problem, q: Array, pairs: list[tuple[int, int]]) -> Array:
    """Return MuJoCo's distances of pairs of geoms at q (nq,), but for those that are far."""
    data, segment = mujoco.MjData(made.model), np.zeros(6)
    data.qpos[:] = q
    mujoco.mj_kinematics(made.model, data)
    return np.array(
        [mujoco.mj_geomDistance(made.model, data, *pair, 0.3, segment) for pair in pairs]
    )


@pytest.mark.parametrize("engine", ["native", "python"])
def test_without_time_a_step_brakes_and_keeps_its_distances(engine: Any) -> None:
    made = rmrc.compile(config(
        str(REPOSITORY / "scenes" / "panda_obstacle.xml"),
        [{"name": "hand", "type": "frame", "frame": {"site": "hand"}}],
        dt=0.01,
        limits={
            "acceleration": {"default": 3.0},
            "velocity": {"default": 1.5},
            "collision": {"pairs": "all", "d_min": 0.02},
        },
    ))  # fmt: skip
    [limit] = (barrier for barrier in made.barriers if isinstance(barrier, CollisionPairs))
    pairs = [(int(a), int(b)) for a, b in limit.geoms]
    rng = np.random.default_rng(0)
    for _ in range(6):
        free = Controller(made, engine)
        target = made.term["hand"].target[4:] + rng.uniform(-0.6, 0.6, 3)
        assert free.set_target("hand", target)
        for _ in range(int(rng.integers(10, 40))):
            free.step()
        late = Controller(replace(made, deadline=1e-9), engine)
        late.reset(free.q, free._v)
        assert late.set_target("hand", target)
        before = least_distance(made, late.q, pairs)
        for _ in range(60):
            v = late._v.copy()
            step = late.step()
            assert step.status is Status.DEADLINE
            left = left_of(v, np.full(v.size, 3.0 * 0.01))
            np.testing.assert_allclose(step.v, left, rtol=0.0, atol=ROUNDING)
            after = least_distance(made, late.q, pairs)
            assert (after >= np.minimum(before, 0.02) - KEPT).all()
            before = after
        assert not late._v.any()


# Geoms that overlap at the start.


def test_arms_that_are_inside_each_other_move_until_they_are_stuck(menagerie: Path) -> None:
    """From MuJoCo's own start of ALOHA no motion takes all pairs apart that overlap."""
    made = problem("aloha", Path())
    [limit] = (barrier for barrier in made.barriers if isinstance(barrier, CollisionPairs))
    pairs = [(int(a), int(b)) for a, b in limit.geoms]
    controller, took = Controller(made, "native"), []
    pose = made.term["left_gripper"].target
    assert controller.set_target("left_gripper", pose[4:] + 0.05)
    for _ in range(100):  # fingers that start outside their ranges come back, which goes first
        controller.step()
    before = least_distance(made, controller.q, pairs)
    for _ in range(1200):
        begin = time.thread_time()
        controller.step()
        took.append(time.thread_time() - begin)
    step = controller.step()
    assert np.percentile(took, 10) < QUICK  # they are all alike
    assert np.abs(step.q - made.start).max() > MOVED
    after = least_distance(made, step.q, pairs)
    assert (after >= np.minimum(before, 0.02) - LOST).all()
    assert {Status.STUCK, Status.RELAXED, Status.RECOVERING} <= step.flags
    account = step.explain()
    assert len(account.passed) == np.count_nonzero(after < 0.02 - KEPT)
    assert account.passed[0].by == pytest.approx(0.02 - after.min(), abs=KEPT)
    assert f"{account.passed[0].name} by" in str(account)


def test_no_row_is_relaxed_to_less_than_the_brake_keeps(menagerie: Path) -> None:
    made = problem("aloha", Path())
    native: Any = Controller(made, "native").engine
    python: Any = Controller(made, "python").engine
    still, relaxed = np.zeros(made.model.nv), 0
    for place in walk(made, 25, seed=3):
        native.solve(place.q, still, made.dt)
        solution = python.solve(place.q, still, made.dt)
        asked, qp, other = python.rows.lower, python.assembly.qp, native.assembly.qp
        assert native.relaxed == python.relaxed
        assert np.isfinite(solution.v).all()
        if not python.relaxed or min(python.share, native.share) < 1.0:
            continue
        relaxed += 1
        braked = qp.C @ np.clip(0.0, qp.lb, qp.ub)
        given = [np.maximum(asked - lower, 0.0) for lower in (qp.lo, other.lo)]
        for way in given:
            assert (way <= np.maximum(asked - braked, 0.0) + KEPT).all()
        # Where its solvers give up, the Python engine has what the brake gives.
        assert np.linalg.norm(given[1]) <= np.linalg.norm(given[0]) + KEPT
    assert relaxed


# What `check` says.


def test_check_says_how_long_the_rows_take(menagerie: Path, tmp_path: Path) -> None:
    slow = problem("g1, stopping, far", tmp_path, 100.0)
    [line] = (line for line in check(slow.config) if "evaluates its rows" in line)
    assert "of a deadline of 0.1 ms: steps end with a brake" in line
    for quick in (problem("panda", tmp_path, 1e5), problem("panda", tmp_path)):
        assert not [line for line in check(quick.config) if "evaluates its rows" in line]
