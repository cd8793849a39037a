"""The speed of a frame: its norm is held, exactly, and little is lost for it."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import config
from rmrc.control.status import Status
from rmrc.qp.program import QP

clarabel: Any = pytest.importorskip("clarabel", reason="solves the cones; of the extra `test`")
sparse: Any = pytest.importorskip("scipy.sparse")

Array = NDArray[np.float64]

# What rounding adds to a speed, m/s or rad/s.
ROUNDING = 1e-12
# Of the optimum under the norm, which the planes inside the ball leave 1e-4 of.
NEAR = 0.01
# Of a conic solver, and of what a command may be off by where the cost is flat.
TOLERANCE = 1e-9
STEPS, NEW_TARGET = 150, 25
CASES: dict[str, dict[str, Any]] = {
    "linear": {"speed": {"linear": 0.25}},
    "angular": {"speed": {"angular": 0.3}},
    "both": {"speed": {"linear": 0.2, "angular": 0.4}},
    "slow": {"speed": {"linear": 0.01}},
    "and joints": {"speed": {"linear": 0.25}, "velocity": {"default": 0.3}},
    "and accelerations": {
        "speed": {"linear": 0.25, "angular": 0.5},
        "acceleration": {"default": 20.0},
    },
}


def made(repository: Path, engine: str, limits: dict[str, Any], **others: Any) -> rmrc.Controller:
    scene = str(repository / "scenes" / "panda.xml")
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    posture = {"name": "posture", "type": "posture", "level": 1, "B": 0.01}
    tasks = [{**hand, **others.pop("hand", {})}, posture]
    given = {**limits, "speed": {"hand": limits["speed"]}}
    problem = rmrc.compile(config(scene, tasks, start="home", dt=0.002, limits=given, **others))
    return rmrc.Controller(problem, engine)  # type: ignore


def jacobian_at(controller: rmrc.Controller, data: mujoco.MjData, q: Array) -> Array:
    """Return J (6, nv) of the hand, by MuJoCo alone."""
    model = controller.problem.model
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site("hand").id)
    return jacobian


def under_the_norm(qp: QP, jacobian: Array, speed: dict[str, float]) -> Array:
    """Return the optimum of a program's cost and box under ‖J v‖ ≤ V, by a conic solver."""
    n = qp.g.size
    rows, right = [np.eye(n), -np.eye(n)], [qp.ub, -qp.lb]
    cones = [clarabel.NonnegativeConeT(2 * n)]
    for part, name in ((slice(3), "linear"), (slice(3, 6), "angular")):
        if name in speed:
            rows.append(np.vstack([np.zeros(n), -jacobian[part]]))
            right.append(np.array([speed[name], 0.0, 0.0, 0.0]))
            cones.append(clarabel.SecondOrderConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    matrix = sparse.csc_matrix(np.vstack(rows))
    cost = sparse.csc_matrix(np.triu(qp.H))
    solver = clarabel.DefaultSolver(cost, qp.g, matrix, np.concatenate(right), cones, settings)
    return np.array(solver.solve().x)


def scatter(controller: rmrc.Controller, rng: np.random.Generator) -> None:
    target = controller.problem.term["hand"].target
    place = target[4:] + rng.uniform(-0.4, 0.4, 3)
    controller.set_target("hand", place, target[:4] + 0.5 * rng.normal(size=4))


@pytest.mark.parametrize("case", CASES)
def test_the_norm_is_held_and_little_is_lost(repository: Path, engine: str, case: str) -> None:
    limits = CASES[case]
    controller = made(repository, engine, limits)
    speed, rng = limits["speed"], np.random.default_rng(0)
    data, active = mujoco.MjData(controller.problem.model), 0
    for k in range(STEPS):
        if k % NEW_TARGET == 0:
            scatter(controller, rng)
        q = controller.q
        step = controller.step()
        assert Status.RELAXED not in step.flags
        jacobian = jacobian_at(controller, data, q)
        linear, angular = np.linalg.norm((jacobian @ step.v).reshape(2, 3), axis=1)
        assert linear <= speed.get("linear", np.inf) + ROUNDING
        assert angular <= speed.get("angular", np.inf) + ROUNDING
        active += linear > 0.99 * speed.get("linear", np.inf)
        active += angular > 0.99 * speed.get("angular", np.inf)
        qp = controller.engine.assembly.qp
        best = under_the_norm(qp, jacobian, speed)

        def cost(v: Array, qp: QP = qp) -> float:
            return float(0.5 * v @ qp.H @ v + qp.g @ v)

        assert cost(step.v) <= cost(best) + NEAR * abs(cost(best)) + TOLERANCE
    assert active > STEPS // 10


def test_a_hand_asked_for_1_m_s_goes_at_its_limit_where_it_is_asked_to(
    repository: Path, engine: str
) -> None:
    """It moved sideways at 0.17 m/s where planes were none of the ball's."""
    hand = {"B": {"orientation": 0.0}, "gain": 100.0}
    controller = made(repository, engine, {"speed": {"linear": 0.25}}, hand=hand)
    data, rng = mujoco.MjData(controller.problem.model), np.random.default_rng(1)
    for _ in range(20):
        controller.reset()
        way = rng.normal(size=3)
        way /= 100.0 * np.linalg.norm(way)
        controller.set_target("hand", controller.problem.term["hand"].target[4:] + way)
        q = controller.q
        v = jacobian_at(controller, data, q)[:3] @ controller.step().v
        along = v @ way / np.linalg.norm(way)
        assert along > (1.0 - NEAR) * 0.25
        assert np.linalg.norm(v) <= 0.25 + ROUNDING


@pytest.mark.parametrize("hand", [{}, {"preserve": "direction"}])
def test_strict_levels_hold_the_norm(repository: Path, engine: str, hand: dict[str, Any]) -> None:
    limits = {"speed": {"linear": 0.2, "angular": 0.5}}
    controller = made(repository, engine, limits, priority="strict", hand=hand)
    data, rng = mujoco.MjData(controller.problem.model), np.random.default_rng(2)
    for k in range(STEPS):
        if k % NEW_TARGET == 0:
            scatter(controller, rng)
        q = controller.q
        step = controller.step()
        moved = jacobian_at(controller, data, q) @ step.v
        assert np.linalg.norm(moved[:3]) <= 0.2 + ROUNDING
        assert np.linalg.norm(moved[3:]) <= 0.5 + ROUNDING
        assert step.status < Status.MAX_ITER


def test_what_is_too_fast_already_slows_down_as_it_may(repository: Path, engine: str) -> None:
    limits = {"speed": {"linear": 0.1}, "acceleration": {"default": 5.0}}
    controller = made(repository, engine, limits)
    controller.reset(v=np.array([0.5, 0.2, 0.3, -0.2, 0.1, 0.4, 0.2]))
    scatter(controller, np.random.default_rng(3))
    data, before = mujoco.MjData(controller.problem.model), np.inf
    for _ in range(60):
        q = controller.q
        step = controller.step()
        speed = float(np.linalg.norm((jacobian_at(controller, data, q) @ step.v)[:3]))
        assert speed <= 0.1 + ROUNDING or (Status.RELAXED in step.flags and speed < before)
        before = speed
    assert before <= 0.1 + ROUNDING
