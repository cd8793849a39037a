"""Many controllers at once: each as if it were alone, whatever the others do and on any thread."""

import threading
import time
from typing import Any

import numpy as np
import pytest
from batches import HAND, PANDA, POSTURE, Array, native, panda, scattered

import rmrc
from models import REPOSITORY, config
from rmrc import BatchController, Controller, Problem, Status

BIPED = str(REPOSITORY / "scenes" / "biped.xml")
TIMED: dict[str, Any] = {"timeout": {"target": 0.1}}
STEPS = 90
"""Of 10 ms, with new targets every 30."""


def biped() -> Problem:
    foot = {"name": "foot", "type": "frame", "frame": {"site": "left_foot"}, "axes": "world"}
    com = {"name": "com", "type": "com", "B": 0.2}
    return rmrc.compile(config(BIPED, [foot, com, POSTURE], dt=0.01))


PROBLEMS = {
    "panda": lambda: panda(),
    "acceleration": lambda: panda(limits={"acceleration": {"default": 8.0}}),
    "adaptive damping": lambda: panda(damping={"lambda": 0.01, "adapt": "sigma_min"}),
    "frozen joint": lambda: panda({"name": "still", "type": "freeze", "joints": ["joint3"]}),
    "some dofs": lambda: panda(dofs=["joint2", "joint4", "joint5", "joint6"]),
    "gaze": lambda: panda({"name": "gaze", "type": "look_at", "frame": {"site": "hand"}}),
    "floating base": biped,
}


def shipped(name: str) -> Problem:
    return rmrc.compile(rmrc.load(REPOSITORY / "configs" / f"{name}.yaml"))


def no_room() -> Problem:
    """Planes that leave the hand no place, beyond both of which it starts."""
    planes = [
        {"frame": {"site": "hand"}, "normal": [0, 0, side], "offset": side * height}
        for side, height in ((1, 0.9), (-1, 0.1))
    ]
    return panda(limits={"workspace": planes, "collision": {"pairs": "all"}})


ROWS = {
    "a ball, a post and a plane": lambda: shipped("panda_obstacle"),
    "two arms": lambda: shipped("dual_arm_collision"),
    "no room between planes": no_room,
}


def inputs(k: int, q: Array, rng: np.random.Generator) -> tuple[Array | None, float | None]:
    """Return q and dt of step k: commanded or measured, some of it not valid."""
    dt = [None, 0.004, 0.02][k % 3]
    if k % 4:
        return None, dt
    q = q + 1e-3 * rng.normal(size=q.shape)
    if k % 8 == 0:
        q[2::9, -1] = np.nan
    return q, dt


def assert_alike(
    batch: BatchController, controllers: list[Controller], steps: int, calm: bool = False
) -> set[Status]:
    """Hold each element to a controller that is given the same; return the statuses met.

    Where it is calm there are targets once, and no measurements.
    """
    rng, met, n = np.random.default_rng(0), set[Status](), batch.n
    for k in range(steps):
        if k == 0 or (k % 30 == 0 and not calm):
            for name, rows in scattered(
                batch.problem, n, rng, 2.0 if calm else 0.1 + 0.02 * k
            ).items():
                pose = rows.shape[1] == 7
                rates = 0.1 * rng.normal(size=(n, 6 if pose else 3)) if k == 30 else None
                accepted = [
                    controller.set_target(
                        name, rows[i, :3], rows[i, 3:] if pose else None,
                        None if rates is None else rates[i],
                    )
                    for i, controller in enumerate(controllers)
                ]  # fmt: skip
                assert batch.set_targets(name, rows, rates).tolist() == accepted
        q, dt = (None, None) if calm else inputs(k, batch.q, rng)
        step = batch.step(q, dt)
        for i, controller in enumerate(controllers):
            alone = controller.step(None if q is None else q[i], dt)
            np.testing.assert_array_equal(step.v[i], alone.v)
            np.testing.assert_array_equal(step.q[i], alone.q)
            assert step.flags[i] == alone.flag_bits
            assert step.status[i] == alone.status
            met |= alone.flags
        assert batch.failures.tolist() == [controller.failures for controller in controllers]
    return met


@native
@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("threads", [1, 3])
def test_an_element_takes_the_steps_of_a_controller(name: str, threads: int) -> None:
    problem, n = PROBLEMS[name](), 40
    batch = BatchController(problem, n, threads=threads)
    assert (batch.engine, batch.threads, batch.notices) == ("native", threads, ())
    met = assert_alike(batch, [Controller(problem) for _ in range(n)], STEPS)
    assert met >= {Status.LIMITED, Status.INVALID_INPUT}


@native
def test_elements_are_stuck_on_their_own_and_start_anew() -> None:
    problem = panda(limits={"velocity": {"default": 3.0}})
    batch = BatchController(problem, 12, threads=2)
    controllers = [Controller(problem) for _ in range(12)]
    for _ in range(2):
        assert Status.STUCK in assert_alike(batch, controllers, 450, calm=True)
        batch.reset()
        for controller in controllers:
            controller.reset()


@native
@pytest.mark.parametrize("name", sorted(p.name for p in (REPOSITORY / "configs").glob("*.yaml")))
def test_shipped_configs(name: str, request: pytest.FixtureRequest) -> None:
    if name.startswith("menagerie"):
        request.getfixturevalue("menagerie")
    problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / name))
    batch = BatchController(problem, 8, threads=2)
    if batch.notices:
        pytest.skip(batch.notices[0])
    assert_alike(batch, [Controller(problem) for _ in range(8)], 100)


@native
@pytest.mark.parametrize("name", ROWS)
def test_what_barriers_remember_is_each_elements_own(name: str) -> None:
    problem, n = ROWS[name](), 18
    batches = [BatchController(problem, n, threads=threads) for threads in (1, 2, 3)]
    assert [(batch.threads, batch.notices) for batch in batches] == [(1, ()), (2, ()), (3, ())]
    controllers, rng = [Controller(problem) for _ in range(n)], np.random.default_rng(0)
    bound, met = 0, 0
    for k in range(120):
        if k % 60 == 0:
            for task, rows in scattered(problem, n, rng, 0.5).items():
                for batch in batches:
                    batch.set_targets(task, rows)
                for controller, row in zip(controllers, rows, strict=True):
                    controller.set_target(task, row[:3], row[3:])
        q, dt = inputs(k, batches[0].q, rng) if k > 60 else (None, None)
        steps = [batch.step(q, dt) for batch in batches]
        for i, controller in enumerate(controllers):
            alone = controller.step(None if q is None else q[i], dt)
            bound += controller.engine.rows.count > 0
            met |= alone.flag_bits
            for step in steps:
                np.testing.assert_array_equal(step.v[i], alone.v)
                np.testing.assert_array_equal(step.q[i], alone.q)
                assert step.flags[i] == alone.flag_bits
    assert bound > 100
    assert met >> Status.RELAXED & 1 or name != "no room between planes"


@native
def test_the_number_of_threads_makes_no_difference() -> None:
    problem, n = panda(), 300
    batches = [BatchController(problem, n, threads=threads) for threads in (1, 2, 5)]
    rng = np.random.default_rng(0)
    for k in range(40):
        if k % 20 == 0:
            targets = scattered(problem, n, rng, 0.5)["hand"]
            accepted = [batch.set_targets("hand", targets) for batch in batches]
            assert not accepted[0].all()
        steps = [batch.step() for batch in batches]
        for other in steps[1:]:
            np.testing.assert_array_equal(other.v, steps[0].v)
            np.testing.assert_array_equal(other.flags, steps[0].flags)


@native
def test_an_iteration_limit_is_met_by_one_alone() -> None:
    problem = panda(solver={"max_iter": 1})
    batch = BatchController(problem, 10)
    hand = problem.term["hand"].target
    targets = np.tile(np.hstack([hand[4:], hand[:4]]), (10, 1))
    targets[4, :3] += [0.5, -3.0, 0.5]  # several joints come to their limits in one step
    assert batch.set_targets("hand", targets).all()
    step = batch.step()
    assert (step.status == Status.MAX_ITER).nonzero()[0].tolist() == [4]
    assert batch.failures[4] == 1
    assert batch.failures.sum() == 1


@native
def test_targets_out_of_reach_for_some() -> None:
    problem = rmrc.compile(config(PANDA, [HAND, {**POSTURE, "B": 1e-3}], dt=0.01))
    batch = BatchController(problem, 20)
    hand = problem.term["hand"].target
    targets = np.tile(np.hstack([hand[4:], hand[:4]]), (20, 1))
    targets[:, 0] += 0.05
    targets[::4, :3] = [0.0, 5.0, 0.0]
    batch.set_targets("hand", targets)
    for _ in range(3000):
        batch.step()
    step = batch.step()
    far = np.arange(20) % 4 == 0
    assert (step.flags[far] >> Status.STUCK & 1).all()
    assert not (step.flags[~far] >> Status.STUCK & 1).any()
    poses = [problem.forward(q)["hand"][:3, 3] for q in step.q[~far]]
    np.testing.assert_allclose(poses, targets[~far, :3], atol=1e-3)


@pytest.mark.parametrize(
    ("engine", "options"),
    [("python", {}), ("auto", TIMED), ("auto", {"limits": {"jerk": {"default": 500.0}}})],
)
def test_without_threads_there_are_controllers(engine: Any, options: dict[str, Any]) -> None:
    problem = panda(**options)
    batch = BatchController(problem, 9, engine=engine)
    assert any("9 controllers are stepped one after the other" in said for said in batch.notices)
    assert batch.threads == 1
    assert_alike(batch, [Controller(problem, engine) for _ in range(9)], 70)


@native
def test_other_threads_of_python_go_on_meanwhile() -> None:
    batch, stamps, over = BatchController(panda(), 4000, threads=1), [], threading.Event()

    def tick() -> None:
        while not over.wait(1e-4):
            stamps.append(time.perf_counter())

    ticking = threading.Thread(target=tick)
    ticking.start()
    try:
        spans = []
        for _ in range(20):
            begin = time.perf_counter()
            batch.step()
            spans.append((begin, time.perf_counter()))
    finally:
        over.set()
        ticking.join()
    inside = [
        begin + 0.25 * (end - begin) < stamp < end - 0.25 * (end - begin)
        for begin, end in spans
        for stamp in stamps
    ]
    assert any(inside)


@native
def test_calls_that_overlap_wait_for_each_other() -> None:
    problem, n = panda(), 500
    batch, twin = BatchController(problem, n, threads=2), BatchController(problem, n, threads=2)
    targets = scattered(problem, n, np.random.default_rng(0), 0.3)["hand"]
    batch.set_targets("hand", targets)
    twin.set_targets("hand", targets)
    callers = [threading.Thread(target=batch.step) for _ in range(8)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    for _ in range(8):
        twin.step()
    np.testing.assert_array_equal(batch.step().v, twin.step().v)
