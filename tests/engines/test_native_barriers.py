"""The native engine's rows against the Python engine's: the same entries, numbers, v and flags."""

import gc
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import CHAIN, PLANES, REPOSITORY, config, random_configuration
from rmrc import Problem
from rmrc.config.models import DampingModel
from rmrc.control.engines import Engine
from rmrc.engine.correction import ENOUGH, SPARE
from rmrc.limits.collision import Collision
from rmrc.qp.program import Solution
from rmrc.qp.rows import Rows

Array = NDArray[np.float64]

if TYPE_CHECKING:
    from rmrc.native.engine import NativeEngine
else:
    native = pytest.importorskip(
        "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
    )
    NativeEngine = native.NativeEngine

SAME = 1e-8 if int(mujoco.__version__.split(".")[0]) >= 4 else 1e-4
"""Of v, relative to its largest element, and of rows: two solvers, and sums in another order.

Before 4.0 MuJoCo adds up its poses in another order than the native engine, and with the last bit
of one the normal between boxes or meshes turns by 1e-5; what `hold` measures is held all the same.
"""
LEAST_RATE = 1e-3
"""rad/s or m/s: a v below it is compared as it is."""
DEEP = 1e-6
"""Of what MuJoCo measures in overlapping geoms by iterations that rounding can end sooner."""
LADDER = 3e-4
"""rad/s or m/s, of v where rows were relaxed, or given slack of 1e-9 because DAQP did not find the
little room that they left; and where a command shortened since rests on that."""
KEPT = 1e-6
"""m or rad; `extents.FINEST`: MuJoCo's distances of smooth geoms are no finer."""
FLAT = 1e-12
"""Largest element of a slope that is 0 but for rounding."""

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "B": 1e-3}
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
ROUGH = {"velocity": {"default": 1.0}, "acceleration": {"default": 8.0}}

AROUND = """
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -0.5"/>
    <body name="box" mocap="true" pos="0.7 0.3 0.4"><geom type="box" size="0.1 0.2 0.05"/></body>
"""
"""What stands around the chain."""
GAINS = [PLANES[0], {**PLANES[1], "gain": 0.5}, PLANES[2]]


class Twins:
    """A Python engine and a native one that are given the same."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.python, self.native = rmrc.Controller(problem, engine="python"), NativeEngine(problem)
        self.engine = self.python.engine
        self.seen, self.rare, self.shortened, self.corrected = 0, 0, 0, 0
        self._end = mujoco.MjData(problem.model)

    def step(self) -> tuple[Solution, Solution]:
        """Take a step with both, from where the Python one is, and compare their rows."""
        evaluation, twin = self.engine.evaluation, self.native.evaluation
        twin.targets[:], twin.twists[:] = evaluation.targets, evaluation.twists
        twin.moving[:], twin.obstacle_twist[:] = evaluation.moving, evaluation.obstacle_twist
        twin.data.mocap_pos[:] = evaluation.data.mocap_pos
        twin.data.mocap_quat[:] = evaluation.data.mocap_quat
        q, v = self.python.q, self.python._v.copy()
        expected = self.python.step().solution
        solution = self.native.solve(q, v, self.problem.dt)
        self.compare(expected, solution)
        for engine, command in ((self.engine, expected), (self.native, solution)):
            if not engine.relaxed:
                self.hold(engine, q, command.v)
        return expected, solution

    def hold(self, engine: Engine, q: Array, v: Array) -> None:
        """Hold the distances where a command leads to what they may be, measured afresh."""
        end, way = self._end, np.zeros(self.problem.model.nv)
        now, twist, dt = engine.evaluation.data, engine.evaluation.obstacle_twist, self.problem.dt
        end.mocap_pos[:], end.mocap_quat[:] = now.mocap_pos + twist[:, :3] * dt, now.mocap_quat
        for quaternion, rate in zip(end.mocap_quat, twist[:, 3:], strict=True):
            local = np.linalg.inv(rotation(quaternion)) @ rate
            mujoco.mju_quatIntegrate(quaternion, local, dt)
        way[self.problem.dofs], end.qpos[:] = v, q
        mujoco.mj_integratePos(self.problem.model, end.qpos, way, dt)
        mujoco.mj_kinematics(self.problem.model, end)
        for block in engine.rows.blocks:
            after = block.barrier.distances(end, block.near.ids)
            assert (after >= np.minimum(block.near.distance, 0.0) - KEPT).all()

    def compare(self, expected: Solution, solution: Solution) -> None:
        python, native = self.engine, self.native
        assert_same_rows(python.rows, native.rows)
        self.seen += python.rows.count > 0
        qp, other = python.assembly.qp, native.assembly.qp
        assert qp.lo.size == other.lo.size
        asked = python.rows.lower if qp.lo.size == python.rows.count else qp.lo
        slack = python.relaxed or bool((qp.lo < asked).any())
        self.rare += slack
        self.shortened += python.share < 1.0
        self.corrected += bool((qp.lo > asked).any())
        largest = max(float(np.abs(expected.v).max()), LEAST_RATE)
        # Whether a distance that is just kept at the end of a step falls short of it, so that its
        # row is raised by what is to spare, is a matter of the last bit.
        tie = not np.allclose(other.lo, qp.lo, rtol=0.0, atol=SAME)
        tolerance = LADDER if slack or tie else SAME * largest
        assert np.abs(solution.v - expected.v).max() <= tolerance
        assert solution.status is expected.status
        assert (native.outside, native.relaxed) == (python.outside, python.relaxed)
        assert native.share == pytest.approx(python.share, abs=LADDER if slack else SAME)
        if not slack:
            sloped = np.abs(qp.C).max(axis=1, initial=0.0) > FLAT
            tied = SAME + ENOUGH * SPARE / self.problem.dt
            np.testing.assert_allclose(other.lo[sloped], qp.lo[sloped], rtol=SAME, atol=tied)


def rotation(quaternion: Array) -> Array:
    """Return the matrix (3, 3) of a quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def assert_same_rows(expected: Rows, found: Rows) -> None:
    """Hold rows to the Python engine's."""
    assert found.count == expected.count
    assert found.passed == expected.passed
    assert len(found.blocks) == len(expected.blocks)
    for ours, theirs in zip(found.blocks, expected.blocks, strict=True):
        assert ours.rows == theirs.rows
        assert ours.near.ids.tolist() == theirs.near.ids.tolist()
        for name in ("distance", "slope", "drift"):
            np.testing.assert_allclose(
                getattr(ours.near, name), getattr(theirs.near, name), rtol=0.0, atol=SAME
            )
    if expected.count:
        np.testing.assert_allclose(found.matrix, expected.matrix, rtol=0.0, atol=SAME)
        # A slope of nothing but rounding says nothing about how fast it may be gone along.
        sloped = np.abs(expected.matrix).max(axis=1) > FLAT
        lower = (found.lower[sloped], expected.lower[sloped])
        np.testing.assert_allclose(*lower, rtol=SAME, atol=SAME)
        np.testing.assert_allclose(found.upper, expected.upper, rtol=SAME, atol=SAME)


def aloha(**limits: Any) -> rmrc.Config:
    tasks = [
        {"name": side, "type": "frame", "frame": {"site": f"{side}/gripper"}}
        for side in ("left", "right")
    ]
    limits = {"collision": {"pairs": "all"}, **limits}
    return config(
        "menagerie:aloha/scene", [*tasks, POSTURE], start="neutral_pose", limits=limits, dt=0.005
    )


def shipped(name: str) -> Callable[[Path], rmrc.Config]:
    return lambda _: rmrc.load(REPOSITORY / "configs" / f"{name}.yaml")


def panda(**limits: Any) -> Callable[[Path], rmrc.Config]:
    return lambda _: config(PANDA, [HAND, POSTURE], limits=limits, dt=0.005)


def chain(**limits: Any) -> Callable[[Path], rmrc.Config]:
    def made(folder: Path) -> rmrc.Config:
        path = folder / "chain.xml"
        path.write_text(CHAIN.replace("<worldbody>", f"<worldbody>{AROUND}"))
        tip = {"name": "hand", "type": "frame", "frame": {"site": "tip"}}
        return config(str(path), [tip, POSTURE], limits=limits, dt=0.005)

    return made


FLOOR = {"workspace": [{"frame": {"site": "hand"}, "normal": [0, 0, 1], "offset": 0.3}]}
CASES: dict[str, Callable[[Path], rmrc.Config]] = {
    "panda and an obstacle": shipped("panda_obstacle"),
    "two arms": shipped("dual_arm_collision"),
    "planes": panda(**FLOOR),
    "planes and stopping": panda(**FLOOR, **ROUGH),
    "speeds": panda(speed={"hand": {"linear": 0.2, "angular": 0.4}}),
    "one speed": panda(speed={"hand": {"linear": 0.2}}),
    "pairs, planes, stopping and a speed": panda(
        collision={"pairs": "all"}, speed={"hand": {"linear": 0.3}}, **FLOOR, **ROUGH
    ),
    "balls": chain(),
    "balls and stopping": chain(acceleration={"default": 6.0}),
    "balls, planes and pairs": chain(workspace=GAINS, collision={"pairs": "all"}),
    "all that stops": chain(
        workspace=GAINS, collision={"pairs": "all"}, acceleration={"default": 6.0}
    ),
}


def wander(twins: Twins, steps: int) -> Iterator[int]:
    """Yield the steps of a run whose targets, and obstacles, jump now and then."""
    controller, rng = twins.python, np.random.default_rng(0)
    model = twins.problem.model
    bodies = [model.body(b).name for b in np.flatnonzero(model.body_mocapid >= 0).tolist()]
    for k in range(steps):
        if k % 60 == 0:
            for name, term in twins.problem.term.items():
                if term.target_kind == "pose":
                    place = term.target[4:] + rng.uniform(-0.4, 0.4, 3)
                    assert controller.set_target(name, place, rng.normal(size=4))
            for name in bodies:
                twist = 0.1 * rng.normal(size=6) * (k % 120 == 0)
                assert controller.set_obstacle(name, velocity=twist)
        data, twist = twins.engine.evaluation.data, twins.engine.evaluation.obstacle_twist
        for name in bodies:
            mocap = int(model.body(name).mocapid[0])
            place = data.mocap_pos[mocap] + twins.problem.dt * twist[mocap, :3]
            assert controller.set_obstacle(name, place, velocity=twist[mocap].copy())
        yield k


@pytest.mark.parametrize("name", CASES)
def test_the_same_rows_and_steps(name: str, tmp_path: Path) -> None:
    twins = Twins(rmrc.compile(CASES[name](tmp_path)))
    for _ in wander(twins, 400):
        twins.step()
    assert twins.seen
    assert twins.rare < 200


@pytest.mark.parametrize(
    ("name", "rungs"),
    [
        ("all that stops", ("rare", "shortened", "corrected")),
        ("balls, planes and pairs", ("rare", "shortened", "corrected")),
    ],
)
def test_the_rungs_of_the_ladder_are_the_extensions_own(
    name: str, rungs: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Braking in time leaves the ladder little to do.
    hasty = {"damping": DampingModel(curvature=False)}
    twins = Twins(rmrc.compile(CASES[name](tmp_path).model_copy(update=hasty)))
    for rung in ("_best", "_descend_ladder", "_at_distance"):
        monkeypatch.setattr(twins.native, rung, unreached)
    for _ in wander(twins, 400):
        twins.step()
    for taken in rungs:
        assert getattr(twins, taken) > 10


def unreached(*_: object) -> Solution:
    raise AssertionError("a step was left to Python")


@pytest.mark.parametrize("limits", [{}, {"acceleration": {"default": 15.0}}], ids=["", "stopping"])
def test_the_arms_of_aloha(limits: dict[str, Any], menagerie: Path) -> None:
    twins = Twins(rmrc.compile(aloha(**limits)))
    for _ in wander(twins, 200):
        twins.step()
    assert twins.seen


@pytest.mark.parametrize("name", ["panda and an obstacle", "two arms", "balls, planes and pairs"])
def test_anywhere_the_rows_are_the_same(name: str, tmp_path: Path) -> None:
    """Jumps from one place to the next: the least favourable to what is remembered."""
    twins, rng = Twins(rmrc.compile(CASES[name](tmp_path))), np.random.default_rng(1)
    model, passed = twins.problem.model, 0
    for _ in range(150):
        q = random_configuration(model, twins.problem.start, rng, 0.8)
        twins.native.prepare(q, np.zeros(model.nv), twins.problem.dt)
        twins.engine.prepare(q, np.zeros(model.nv), twins.problem.dt)
        found, expected = twins.native.rows, twins.engine.rows
        assert (found.count, found.passed) == (expected.count, expected.passed)
        for ours, theirs in zip(found.blocks, expected.blocks, strict=True):
            assert ours.near.ids.tolist() == theirs.near.ids.tolist()
            difference = np.abs(ours.near.distance - theirs.near.distance)
            assert difference.max() <= DEEP
        passed += expected.passed
    assert passed


def test_python_and_the_extension_take_turns(tmp_path: Path) -> None:
    twins = Twins(rmrc.compile(CASES["two arms"](tmp_path)))
    native = twins.native
    for k in wander(twins, 200):
        twins.step()
        if k % 3 == 0:  # the Python barriers look at the same arrays
            for barrier in native.rows.barriers:
                assert isinstance(barrier, Collision)
                least, expected = (
                    engine.rows.barriers[0].least(engine.evaluation.data)
                    for engine in (native, twins.engine)
                )
                assert least[0] == pytest.approx(expected[0], abs=SAME)
        if k % 7 == 0:
            native.evaluation.update(native.evaluation.data.qpos)
            Rows.update(native._rows, native.assembly.qp, native.assembly.rate, twins.problem.dt)
            assert_same_rows(twins.engine.rows, native._rows)


def test_starts_inside_of_each_other(tmp_path: Path) -> None:
    twins, rng = Twins(rmrc.compile(CASES["two arms"](tmp_path))), np.random.default_rng(2)
    deep = 0
    for _ in range(30):
        q = random_configuration(twins.problem.model, twins.problem.start, rng, 0.6)
        twins.python.reset(q)
        twins.native.reset()
        for _ in range(5):
            twins.step()
        deep += twins.engine.rows.passed
    assert deep


@pytest.mark.parametrize("name", ["panda and an obstacle", "all that stops", "one speed"])
def test_a_controller_takes_the_same_steps_and_tells_the_same_of_them(
    name: str, tmp_path: Path
) -> None:
    problem = rmrc.compile(CASES[name](tmp_path))
    ours, theirs = (rmrc.Controller(problem, engine=engine) for engine in ("native", "python"))
    rng, told = np.random.default_rng(0), 0
    hand = next(name for name, term in problem.term.items() if term.target_kind == "pose")
    for k in range(300):
        if k % 60 == 0:
            place = problem.term[hand].target[4:] + rng.uniform(-0.4, 0.4, 3)
            for controller in (ours, theirs):
                controller.set_target(hand, place)
        step, expected = ours.step(), theirs.step()
        assert step.flags == expected.flags
        np.testing.assert_allclose(step.v, expected.v, rtol=0.0, atol=LADDER)
        assert step.moment.share == pytest.approx(expected.moment.share, abs=LADDER)
        engine, other = ours.engine, theirs.engine
        assert_same_rows(other.rows, engine.rows)
        assert (engine.share == 1.0) == (other.share == 1.0)
        found, wanted = step.explain(), expected.explain()
        active = {(b.limit, b.name, b.side) for b in wanted.bindings if b.multiplier > LADDER}
        assert active <= {(b.limit, b.name, b.side) for b in found.bindings}
        told += any(b.limit not in ("velocity", "acceleration") for b in found.bindings)
        # They go on alike, although an explanation has taken both engines elsewhere and back.
        ours._q[:], ours._v[:] = theirs._q, theirs._v
    assert told


def test_an_engine_is_let_go_of(tmp_path: Path) -> None:
    engine = NativeEngine(rmrc.compile(CASES["balls, planes and pairs"](tmp_path)))
    gone = weakref.ref(engine)
    del engine
    gc.collect()
    assert gone() is None


def test_runs_are_the_same_bit_by_bit(tmp_path: Path) -> None:
    runs = []
    for _ in range(2):
        twins = Twins(rmrc.compile(CASES["two arms"](tmp_path)))
        runs.append([twins.step()[1].v for _ in wander(twins, 100)])
    assert np.array_equal(*runs)
