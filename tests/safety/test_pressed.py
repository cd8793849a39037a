"""Pressed on a wall, a post, an edge or another arm the robot settles, and never shakes."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config
from rmrc.control.engines import build_engine
from rmrc.runs.target_paths import build_aims

Array = NDArray[np.float64]

FAST = 1e-3
"""rad/s or m/s: a rate below it may shake by rounding."""
WINDOW = 10
"""Steps in which an acceleration may not change its sign every time."""
SECONDS = 3.0
RESTS = 2e-2
"""Largest rate at the end of a run, rad/s or m/s: what creeps along a wall, where the deceleration
is small, is on its way still."""
PASSED = 1e-6
"""m; what a distance may be below `d_min`."""
NEEDED = 0.01
"""Share of the steps of `dual_arm_collision` in which the check where a command leads may act."""
SAME = 1e-8
"""rad/s: two engines, from the same state."""

HAND: list[dict[str, Any]] = [
    {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
    {"name": "posture", "type": "posture", "level": 1, "B": 0.01, "gain": 1.0},
]
PANDA = f"""<mujoco><compiler angle="radian"/><include file="{REPOSITORY}/scenes/panda.xml"/>
<worldbody>%s</worldbody></mujoco>"""
WALL = '<geom name="thing" type="box" pos="0.75 0 0.5" size="0.05 0.5 0.5"/>'
POST = '<geom name="thing" type="capsule" fromto="0.55 0.25 0 0.55 0.25 1" size="0.05"/>'
# A capsule that a slide presses flat on the face of a cylinder, turned by a hinge.
CAPSULE = """<mujoco><compiler angle="radian"/><worldbody>
  <geom name="thing" type="cylinder" size="0.2 0.05"/>
  <body pos="0 0 0.3"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><joint name="turn" type="hinge" axis="0 1 0"/>
    <geom name="tip" type="capsule" fromto="-0.1 0 0 0.1 0 0" size="0.03"/>
    <site name="hand" pos="0.05 0 0"/></body>
</worldbody></mujoco>"""
SCENES: dict[str, tuple[str, list[float]]] = {
    "wall": (PANDA % WALL, [0.75, 0.2, 0.5]),
    "post": (PANDA % POST, [0.5, 0.5, 0.45]),
    "capsule": (CAPSULE, [0.02, 0.0, -0.1]),
}


def native() -> Any:
    """Return the choice of the native engine; without it the test is skipped."""
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    return "native"


def limits(acceleration: float | None, d_min: float = 0.02) -> dict[str, Any]:
    return {
        "velocity": {"default": 2.0},
        "acceleration": "off" if acceleration is None else {"default": acceleration},
        "collision": {"pairs": "all", "d_min": d_min, "detect": 0.1},
    }


def pressed(name: str, folder: Path, acceleration: float | None, dt: float) -> rmrc.Problem:
    """Return a problem whose hand is sent to behind something."""
    scene, _ = SCENES[name]
    path = folder / f"{name}.xml"
    path.write_text(scene)
    start = {} if name == "capsule" else {"start": "home"}
    return rmrc.compile(config(str(path), HAND, dt=dt, limits=limits(acceleration), **start))


def two_arms(acceleration: float | None, dt: float) -> rmrc.Problem:
    """Return two arms that are sent through one another."""
    tasks = [
        {
            "name": side,
            "type": "frame",
            "frame": {"site": f"{side}_hand"},
            "B": {"position": 1.0, "orientation": 0.0},
        }
        for side in ("left", "right")
    ]
    scene = str(REPOSITORY / "scenes" / "dual_arm.xml")
    all_limits = limits(acceleration, 0.03)
    return rmrc.compile(config(scene, [*tasks, HAND[1]], start="home", dt=dt, limits=all_limits))


class Distances:
    """Measures how much nearer than allowed the pairs of a problem are, by MuJoCo."""

    def __init__(self, problem: rmrc.Problem):
        self._model, self._data = problem.model, mujoco.MjData(problem.model)
        controller = rmrc.Controller(problem, "python")
        (barrier,) = controller.engine.rows.barriers
        self._pairs = barrier.spec.geoms.tolist()  # pyright: ignore[reportAttributeAccessIssue]
        self._d_min = problem.config.limits.collision.d_min  # pyright: ignore

    def passed(self, q: Array) -> float:
        """Return by how much the nearest pair is below `d_min` at q (nq,), m."""
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        least = min(
            mujoco.mj_geomDistance(model, data, a, b, self._d_min, None) for a, b in self._pairs
        )
        return self._d_min - least


def shaking(rates: Array, dt: float) -> int:
    """Return in how many windows a joint's acceleration changes its sign at every step (N, n)."""
    acceleration = np.diff(rates, axis=0) / dt
    turns = acceleration[1:] * acceleration[:-1] < 0.0
    turns &= np.abs(rates[1:-1]) > FAST
    views = np.lib.stride_tricks.sliding_window_view(turns, WINDOW - 1, axis=0)
    return int(views.all(axis=-1).sum())


def run(
    problem: rmrc.Problem, engine: Any, targets: dict[str, list[float]], every: int = 10
) -> tuple[Array, float]:
    """Return the rates (N, nv) of a run, and the most that a distance falls below its limit."""
    controller, distances = rmrc.Controller(problem, engine), Distances(problem)
    for name, target in targets.items():
        assert controller.set_target(name, position=target)
    rates, passed = [], -np.inf
    for k in range(round(SECONDS / problem.dt)):
        step = controller.step()
        rates.append(step.v)
        if k % every == 0:
            passed = max(passed, distances.passed(step.q))
    return np.array(rates), passed


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.01])
@pytest.mark.parametrize("acceleration", [None, 2.0, 10.0, 50.0])
@pytest.mark.parametrize("name", SCENES)
def test_it_settles(name: str, acceleration: float | None, dt: float, tmp_path: Path) -> None:
    problem = pressed(name, tmp_path, acceleration, dt)
    rates, passed = run(problem, native(), {"hand": SCENES[name][1]})
    assert shaking(rates, dt) == 0
    assert np.abs(rates[-1]).max() < RESTS
    assert passed <= PASSED


@pytest.mark.parametrize("acceleration", [None, 10.0, 50.0])
def test_two_arms_that_press_together_do_not_shake(acceleration: float | None) -> None:
    problem = two_arms(acceleration, 0.01)
    targets = {"left": [0.5, -0.12, 1.25], "right": [0.5, 0.12, 1.25]}
    rates, passed = run(problem, native(), targets, every=5)
    assert shaking(rates, problem.dt) == 0
    assert passed <= PASSED


@pytest.mark.parametrize("acceleration", [None, 10.0])
def test_the_check_is_hardly_needed(acceleration: float | None) -> None:
    overrides = {} if acceleration is None else {"limits.acceleration.default": acceleration}
    shipped = str(REPOSITORY / "configs" / "dual_arm_collision.yaml")
    problem = rmrc.compile(rmrc.load(shipped, overrides=overrides))
    controller = rmrc.Controller(problem, native())
    aims, rates, needed = build_aims(problem), [], 0
    for k in range(problem.config.steps):
        for aim in aims:
            aim.sample(k * problem.dt)
            aim.set_on(controller)
        step = controller.step()
        rates.append(step.v)
        program, rows = controller.engine.assembly.qp, controller.engine.rows
        moved = program.lo.size != rows.count or bool((program.lo != rows.lower).any())
        needed += step.moment.share < 1.0 or moved
    assert needed < NEEDED * len(rates)
    assert shaking(np.array(rates), problem.dt) == 0


@pytest.mark.parametrize("acceleration", [None, 10.0])
@pytest.mark.parametrize("name", SCENES)
def test_both_engines_press_alike(name: str, acceleration: float | None, tmp_path: Path) -> None:
    problem = pressed(name, tmp_path, acceleration, 0.005)
    controller, twin = rmrc.Controller(problem, "python"), build_engine(problem, native())[0]
    assert controller.set_target("hand", position=SCENES[name][1])
    twin.evaluation.targets[:] = controller.engine.evaluation.targets
    q, v = controller.q, np.zeros(problem.model.nv)
    for _ in range(150):
        step = controller.step(q)
        other = twin.solve(q, v, problem.dt)
        np.testing.assert_allclose(other.v, step.solution.v, rtol=0.0, atol=SAME)
        q, v = step.q, step.v


def test_what_was_kept_is_forgotten_at_a_reset(engine: Any, tmp_path: Path) -> None:
    problem = pressed("wall", tmp_path, None, 0.01)
    controller = rmrc.Controller(problem, engine)
    runs = []
    for _ in range(2):
        controller.reset(problem.start)
        assert controller.set_target("hand", position=SCENES["wall"][1])
        runs.append(np.array([controller.step().v for _ in range(120)]))
    np.testing.assert_array_equal(*runs)


def test_what_was_kept_is_forgotten_where_the_robot_is_put_elsewhere(
    engine: Any, tmp_path: Path
) -> None:
    problem = pressed("wall", tmp_path, None, 0.01)
    controller = rmrc.Controller(problem, engine)
    rng = np.random.default_rng(3)
    barriers = controller.engine.rows.barriers
    lower, upper = problem.model.jnt_range.T
    for _ in range(30):
        controller.step(rng.uniform(lower, upper))
    kept = [barrier.kept(controller.engine.evaluation.data) for barrier in barriers]
    assert not any(near is not None and near.ids.size for near in kept)
