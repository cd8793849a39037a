"""The native engine against the Python one, which is its specification, step by step.

Its C++ tests, for the sanitizers and for memory, are in `native/tests`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from twins import assert_equal, twins

import rmrc
from models import MENAGERIE, REPOSITORY, ROBOTS, config, scene_path
from rmrc.control.engines import build_engine

if TYPE_CHECKING:
    from rmrc.native.engine import NativeEngine
else:
    NativeEngine = pytest.importorskip(
        "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
    ).NativeEngine

STEPS = 200
SAME_WAY = 1e-6
"""rad, of two runs of 50 steps whose solver stops at its own tolerance."""

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
BIPED = str(REPOSITORY / "scenes" / "biped.xml")
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
LEFT: dict[str, Any] = {"name": "left", "type": "frame", "frame": {"site": "left_hand"}}
FULL = (np.eye(6) + 0.3 * np.ones((6, 6))).tolist()
ROUGH = {"velocity": {"default": 1.0}, "acceleration": {"default": 8.0}}


def shipped() -> list[str]:
    return sorted(path.name for path in (REPOSITORY / "configs").glob("*.yaml"))


@pytest.mark.parametrize("name", shipped())
@pytest.mark.parametrize("moving", [False, True], ids=["targets rest", "targets move"])
def test_shipped_configs(name: str, moving: bool, request: pytest.FixtureRequest) -> None:
    if name.startswith("menagerie"):
        request.getfixturevalue("menagerie")
    problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / name))
    assert_equal(problem, STEPS, moving=moving)


TASKS: dict[str, list[dict[str, Any]]] = {
    "world axes": [{**HAND, "axes": "world"}],
    "full weight": [{**HAND, "B": FULL}],
    "full weight, world axes": [{**HAND, "B": FULL, "axes": "world"}],
    "weights of halves": [{**HAND, "B": {"position": 4.0, "orientation": 0.0}}],
    "clamps": [{**HAND, "clamp": {"position": 0.02, "orientation": 0.05}}],
    "deadbeat": [{**HAND, "gain": "deadbeat"}],
    "body and geom": [
        {**HAND, "frame": {"body": "link7"}},
        {"name": "elbow", "type": "com", "body": "link4", "B": 0.3, "clamp": 0.05},
    ],
    "relative": [
        {"name": "pair", "type": "relative_frame", "frame": {"site": "hand"},
         "root": {"body": "link4"}, "clamp": {"position": 0.05}}
    ],
    "look at": [
        {**HAND, "B": {"position": 1.0, "orientation": 0.0}},
        {"name": "gaze", "type": "look_at", "frame": {"site": "hand"}, "B": 0.5},
    ],
    "axis": [
        {**HAND, "B": {"position": 1.0, "orientation": 0.0}},
        {"name": "up", "type": "axis_align", "frame": {"body": "link6"}, "axis": [0, 1, 0]},
    ],
    "joints": [
        HAND,
        {"name": "posture", "type": "posture", "level": 1, "B": (2.0 * np.eye(7)).tolist()},
        {"name": "rates", "type": "velocity", "target": {"joint1": 0.3}, "B": 0.1},
        {"name": "calm", "type": "smooth", "B": 0.2},
        {"name": "middle", "type": "centering", "level": 2},
        {"name": "light", "type": "kinetic_energy", "B": 0.01},
        {"name": "still", "type": "freeze", "joints": ["joint3"]},
    ],
    "coupling": [
        HAND,
        {"name": "pair", "type": "coupling", "coefficients": {"joint2": 1.0, "joint4": 0.5},
         "offset": 0.2, "hard": False},
    ],
}  # fmt: skip
OPTIONS: dict[str, dict[str, Any]] = {
    "velocity": {},
    "acceleration": {"limits": ROUGH},
    "jerk": {"limits": {**ROUGH, "jerk": {"default": 200.0}}},
    "no limits": {"limits": {"velocity": "off", "position": "off"}},
    "some dofs": {"dofs": ["joint2", "joint4", "joint5", "joint6"]},
}


@pytest.mark.parametrize("tasks", TASKS)
@pytest.mark.parametrize("options", OPTIONS)
def test_every_task_within_every_limit(tasks: str, options: str) -> None:
    problem = rmrc.compile(config(PANDA, TASKS[tasks], dt=0.005, **OPTIONS[options]))
    assert_equal(problem, steps=200, moving=options in ("jerk", "some dofs"))


METRICS: dict[str, dict[str, Any]] = {
    "number": {"metric": 0.3},
    "diagonal": {"metric": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]},
    "inertia": {"metric": "inertia"},
    "sigma_min": {"damping": {"lambda": 0.01, "adapt": "sigma_min", "threshold": 0.5}},
    "manipulability": {"damping": {"lambda": 0.01, "adapt": "manipulability", "threshold": 0.5}},
    "error": {"damping": {"lambda": 0.01, "adapt": "error"}},
}


@pytest.mark.parametrize("options", METRICS)
@pytest.mark.parametrize("weight", [1.0, {"position": 1.0, "orientation": 0.0}, FULL])
def test_metrics_and_damping(options: str, weight: Any) -> None:
    tasks = [{**HAND, "B": weight}, {"name": "posture", "type": "posture", "level": 1}]
    assert_equal(rmrc.compile(config(PANDA, tasks, **METRICS[options])), STEPS)


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_of_one_to_many_dofs(robot: str, tmp_path: Path) -> None:
    site, other = ROBOTS[robot]
    tasks = [
        {**HAND, "frame": {"site": site}},
        {"name": "com", "type": "com", "B": 0.2},
        {"name": "posture", "type": "posture", "B": 1e-3},
    ]
    if robot != "pendulum":  # whose other frame stands still
        tasks.append({"name": "other", "type": "frame", "frame": other, "B": 0.1, "axes": "world"})
    problem = rmrc.compile(config(scene_path(robot, tmp_path), tasks))
    assert_equal(problem, STEPS, moving=True)


@pytest.mark.parametrize("robot", MENAGERIE)
def test_real_robots(robot: str, menagerie: Path) -> None:
    scene, frame = MENAGERIE[robot]
    tasks = [{**HAND, "frame": frame}, {"name": "posture", "type": "posture", "B": 0.01}]
    problem = rmrc.compile(config(f"menagerie:{scene}", tasks, limits=ROUGH))
    assert_equal(problem, steps=2000)


def test_a_controller_takes_the_same_steps_and_tells_the_same_of_them() -> None:
    tasks = [HAND, {"name": "posture", "type": "posture", "level": 1, "gain": 10.0}]
    problem = rmrc.compile(config(PANDA, tasks, limits=ROUGH, dt=0.01))
    ours = [rmrc.Controller(problem, engine=engine) for engine in ("native", "python")]
    rng, flags = np.random.default_rng(0), frozenset[rmrc.Status]()
    for k in range(2600):
        far, moving = (0.1 if k < 200 else 3.0), k < 200
        if k % 200 == 0 and k < 500:
            place = problem.term["hand"].target[4:] + rng.uniform(-far, far, 3)
            twist = 0.1 * rng.normal(size=6)
            for controller in ours:
                assert controller.set_target("hand", place, velocity=twist if moving else None)
        measured = None if k % 3 else ours[1].q
        native, python = (controller.step(measured) for controller in ours)
        # Each goes on from its own q: what differs in a step stays small, and does not add up.
        np.testing.assert_allclose(native.v, python.v, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(native.q, python.q, rtol=0.0, atol=1e-6)
        assert (flags := native.flags) == python.flags
        for name, error in python.error.items():
            np.testing.assert_allclose(native.error[name], error, rtol=0.0, atol=1e-6)
    assert rmrc.Status.STUCK in flags
    old = ours[0].step()
    before = old.explain()
    ours[0].set_target("hand", problem.term["hand"].target[4:])
    ours[0].step()
    assert str(old.explain()) == str(before)


def test_what_is_not_plain_is_taken_as_it_is_meant() -> None:
    problem = rmrc.compile(config(PANDA, [HAND]))
    plain, other = rmrc.Controller(problem), rmrc.Controller(problem)
    place, q = problem.term["hand"].target[4:] + 0.05, problem.start
    assert plain.set_target("hand", place)
    assert other.set_target("hand", place.tolist())
    wide = np.repeat(q, 2)[::2]
    for given in (q.tolist(), wide):
        assert np.array_equal(plain.step(q).v, other.step(given).v)
    assert not plain.set_target("hand", np.full(3, np.nan))
    assert rmrc.Status.INVALID_INPUT in plain.step().flags
    assert plain.step(np.full(7, np.nan)).status is rmrc.Status.INVALID_INPUT
    assert plain.step(q, dt=-1.0).status is rmrc.Status.INVALID_INPUT


def test_runs_are_the_same_bit_by_bit() -> None:
    runs = []
    for _ in range(2):
        problem = rmrc.compile(config(BIPED, [LEFT, {"name": "com", "type": "com"}], limits=ROUGH))
        runs.append([native.v for _, native in twins(problem, STEPS, moving=True)])
    assert np.array_equal(*runs)


def test_a_number_that_is_not_finite_ends_in_the_brake() -> None:
    problem = rmrc.compile(config(PANDA, [HAND], limits=ROUGH))
    native, v = NativeEngine(problem), np.full(7, 0.5)
    native.evaluation.target["hand"][4] = np.nan
    solution = native.solve(problem.start, v, problem.dt)
    assert solution.status.value == "failed"
    assert solution.v == pytest.approx(np.full(7, 0.5 - 8.0 * problem.dt), abs=1e-12)
    native.evaluation.target["hand"][4] = 0.4
    assert native.solve(problem.start, v, problem.dt).status.value == "solved"


def test_without_time_or_iterations_v_is_a_feasible_point() -> None:
    tight = {"velocity": {"default": 0.2}}
    problem = rmrc.compile(config(PANDA, [HAND], limits=tight, solver={"max_iter": 1}))
    native = NativeEngine(problem)
    native.evaluation.target["hand"][4:] = [0.2, 0.6, 0.3]
    solution = native.solve(problem.start, np.zeros(7), problem.dt)
    assert solution.status.value == "max_iter"
    assert np.abs(solution.v).max() <= 0.2
    native.deadline = 0.0  # long past
    solution = native.solve(problem.start, np.zeros(7), problem.dt)
    assert solution.status.value == "time_limit"
    assert np.abs(solution.v).max() <= 0.2


def test_auto_takes_the_native_engine_where_it_can() -> None:
    problem = rmrc.compile(config(PANDA, [HAND]))
    assert rmrc.Controller(problem).engine.name == "native"
    assert rmrc.Controller(problem).notices == ()
    assert rmrc.Controller(problem, engine="python").engine.name == "python"
    named = rmrc.compile(config(PANDA, [HAND], engine="python"))
    assert rmrc.Controller(named).engine.name == "python"
    assert rmrc.Controller(named, engine="native").engine.name == "native"


LACKING: dict[str, dict[str, Any]] = {
    "programs without damping": {"damping": {"lambda": 0.0}},
    "tolerance of a backend's": {"solver": {"tolerance": 1e-6}},
}


@pytest.mark.parametrize("what", LACKING)
def test_what_it_lacks_is_named(what: str) -> None:
    problem = rmrc.compile(config(PANDA, [HAND], **LACKING[what]))
    engine, notices = build_engine(problem, "auto")
    assert engine.name == "python"
    assert notices == (f"the Python engine runs: the native engine has no {what}",)
    with pytest.raises(rmrc.ConfigError, match=f"native cannot run.*no {what}"):
        build_engine(problem, "native")


def test_the_manifest_says_which_engine_ran() -> None:
    run = rmrc.solve(config(PANDA, [HAND], duration=0.01))
    assert (run.summary["engine"], run.summary["backend"]) == ("native", "native")
    run = rmrc.solve(config(PANDA, [HAND], duration=0.01, solver={"backend": "osqp"}))
    assert (run.summary["engine"], run.summary["backend"]) == ("native", "osqp")


@pytest.mark.parametrize("backend", ["daqp", "proxqp", "osqp", "clarabel"])
def test_a_backend_that_is_named_solves_for_both_engines(backend: str) -> None:
    made = config(
        PANDA,
        [HAND],
        limits={"collision": {"pairs": "all", "d_min": 0.02, "detect": 0.2}},
        targets={"hand": {"path": "pose", "position": [0.3, 0.3, 0.4]}},
        duration=0.1,
        solver={"backend": backend},
    )
    ways = []
    for engine in ("native", "python"):
        run = rmrc.solve(made.model_copy(update={"engine": engine}))
        assert (run.summary["engine"], run.summary["backend"]) == (engine, backend)
        ways.append(run.q)
    np.testing.assert_allclose(*ways, rtol=0.0, atol=SAME_WAY)
