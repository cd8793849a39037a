"""Strict levels are lexicographic inside the limits, and what soft ones tend to."""

import json

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import rmrc
from models import REPOSITORY, config
from rmrc.qp.backends import create
from rmrc.qp.cascade import Cascade, Level
from rmrc.qp.program import QP
from rmrc.reference import prioritized

# Of rates of the order of 1, past two SVDs and two programs of conditions up to 1e6.
STRICT = 1e-8
# The cascade's damping of 1e-12 moves its optimum by as much, over σ² ≥ 1e-3.
UNDAMPED = 1e-12


def cascade(n: int) -> Cascade:
    return Cascade(n, lambda: create("daqp"))


def box(bound: np.ndarray) -> QP:
    limits = QP(bound.size)
    limits.lb[:], limits.ub[:] = -bound, bound
    return limits


def levels(tasks: list[tuple[np.ndarray, np.ndarray]]) -> list[Level]:
    n = tasks[0][0].shape[1]
    asked = [Level(jacobian, rate, UNDAMPED * np.eye(n)) for jacobian, rate in tasks]
    return [*asked, Level(np.zeros((0, n)), np.zeros(0), np.eye(n))]


def random_tasks(rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    n = int(rng.integers(4, 9))
    sizes = rng.integers(1, 4, size=3)
    return [(rng.normal(size=(m, n)), rng.normal(size=m)) for m in sizes]


@pytest.mark.parametrize("seed", range(50))
def test_without_active_limits_the_cascade_is_the_prioritized_recursion(seed: int) -> None:
    tasks = random_tasks(np.random.default_rng(seed))
    n = tasks[0][0].shape[1]
    solution = cascade(n).solve(levels(tasks), QP(n))
    expected = prioritized(tasks)
    assert np.abs(solution.v - expected).max() < STRICT * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("seed", range(50))
def test_inside_limits_each_level_is_optimal_where_those_above_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tasks = random_tasks(rng)
    n = tasks[0][0].shape[1]
    bound = rng.uniform(0.05, 0.5, n)
    v = cascade(n).solve(levels(tasks), box(bound)).v
    assert (np.abs(v) <= bound).all()
    # An independent solver finds no better first level anywhere in the box.
    jacobian, rate = tasks[0]
    best = lsq_linear(jacobian, rate, (-bound, bound), method="bvls", tol=1e-14).x
    ours, theirs = (np.linalg.norm(jacobian @ x - rate) for x in (v, best))
    assert ours <= theirs + STRICT
    # Nor a better second level with the first held, by a weight that holds it to 1e-6.
    weight = 1e6
    stacked = np.vstack([weight * jacobian, tasks[1][0]])
    wanted = np.concatenate([weight * (jacobian @ v), tasks[1][1]])
    best = lsq_linear(stacked, wanted, (-bound, bound), method="bvls", tol=1e-14).x
    ours, theirs = (np.linalg.norm(tasks[1][0] @ x - tasks[1][1]) for x in (v, best))
    assert ours <= theirs + 1e-5


def test_soft_levels_converge_to_strict_ones_at_the_rate_of_the_weight() -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "B": [1, 1, 0, 0, 0, 0]}
    second = {"name": "rest", "type": "posture", "target": [1.0, -1.0, 0.5, 1.5], "level": 1}
    scene = str(REPOSITORY / "scenes" / "planar_4r.xml")
    off = {"position": "off", "velocity": "off"}

    def step(**others) -> np.ndarray:
        damping = {"lambda": 0.0, "curvature": "off"}
        made = config(scene, [hand, second], damping=damping, limits=off, **others)
        controller = rmrc.Controller(rmrc.compile(made))
        target = controller.problem.term["hand"].target
        controller.set_target("hand", target[4:] + [0.1, -0.1, 0.0])
        return controller.step().v

    strict = step(priority="strict")
    apart = [np.abs(step(soft_ratio=ratio) - strict).max() for ratio in (1e-2, 1e-3, 1e-4, 1e-5)]
    ratios = np.array(apart[:-1]) / apart[1:]
    assert ratios == pytest.approx([10.0, 10.0, 10.0], rel=0.1)


def test_the_golden_strict_case(repository) -> None:
    path = repository.parent / "shared" / "golden" / "closed_form.json"
    if not path.is_file():
        pytest.skip("needs the golden closed forms")
    cases = {case["name"]: case for case in json.loads(path.read_text())["cases"]}
    case = cases["3r strict priority: row x first, then sum of joint rates = 1"]
    tasks = [(np.array(case[key]), np.array([1.0])) for key in ("level_1", "level_2")]
    v = cascade(3).solve(levels(tasks), QP(3)).v
    assert v == pytest.approx(case["expect"], abs=STRICT)


def test_a_preserved_direction_is_as_fast_as_the_limits_allow(repository) -> None:
    path = repository.parent / "shared" / "golden" / "closed_form.json"
    if not path.is_file():
        pytest.skip("needs the golden closed forms")
    cases = {case["name"]: case for case in json.loads(path.read_text())["cases"]}
    case = cases["4r direction kept, |v| <= 1, largest attainable share of xdot"]
    jacobian, rate = np.array(case["J"]), np.array(case["xdot"])
    solver, bound = cascade(4), np.array(case["v_max"])
    directed = Level(jacobian, rate, UNDAMPED * np.eye(4), (jacobian, rate))
    v = solver.solve([directed], box(bound)).v
    assert solver.scale == pytest.approx(case["expect"][0], abs=1e-9)
    assert jacobian @ v == pytest.approx(solver.scale * rate, abs=1e-9)


def test_a_preserved_direction_runs_through_the_controller_and_is_said() -> None:
    hand = {
        "name": "hand",
        "type": "frame",
        "frame": {"site": "hand"},
        "B": {"position": 1.0, "orientation": 0.5},
        "preserve": "direction",
    }
    rest = {"name": "rest", "type": "posture", "level": 1}
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    slow = config(scene, [hand, rest], limits={"velocity": {"default": 0.3}})
    controller = rmrc.Controller(rmrc.compile(slow))
    target = controller.problem.term["hand"].target
    controller.set_target("hand", target[4:] + [-0.1, 0.2, -0.1])
    evaluation = controller.engine.evaluation
    step = controller.step()
    assert step.status is rmrc.Status.SCALED
    moved = evaluation.jacobian @ step.v
    wanted = 10.0 * evaluation.error[:6]
    share = moved @ wanted / (wanted @ wanted)
    assert 0.0 < share < 1.0
    assert moved == pytest.approx(share * wanted, abs=1e-7)
    assert np.abs(step.v).max() == pytest.approx(0.3, abs=1e-9)
