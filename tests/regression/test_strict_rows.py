"""Strict levels inside rows and equalities: feasible, lexicographic, and as before without any."""

import numpy as np
import pytest
from numpy.typing import NDArray
from test_strict import STRICT, UNDAMPED, cascade, levels, random_tasks

from rmrc.qp.backends import create
from rmrc.qp.backends.daqp import DAQP
from rmrc.qp.cascade import Cascade, Level
from rmrc.qp.program import QP, Solution, SolveStatus

Array = NDArray[np.float64]
Tasks = list[tuple[Array, Array]]

# What equalities may be off by: one SVD and the polish of one projection.
HELD = 1e-9
# What a row may be passed by: the most room that is given where a program is falsely refused.
INSIDE = 2e-7
# Between two solvers: the polish of the other ends at residuals of 1e-9, over σ² ≥ 1e-3.
AGREE = 1e-7

seeds = pytest.mark.parametrize("seed", range(40))


def inside(
    rng: np.random.Generator, n: int, rows: int, equalities: int, room: float = 0.1
) -> tuple[QP, Array]:
    """Return random limits, and a v (n,) that is `room` away from the rows."""
    limits, bound = QP(n, rows, equalities), rng.uniform(0.2, 0.8, n)
    limits.lb[:], limits.ub[:] = -bound, bound
    v = rng.uniform(-0.5, 0.5, n) * bound
    limits.C[:], limits.E[:] = rng.normal(size=(rows, n)), rng.normal(size=(equalities, n))
    limits.lo[: rows // 2] = (limits.C @ v - room)[: rows // 2]
    limits.hi[rows // 2 :] = (limits.C @ v + room)[rows // 2 :]
    limits.f[:] = limits.E @ v
    return limits, v


def assert_inside(v: Array, limits: QP) -> None:
    assert (limits.lb <= v).all()
    assert (v <= limits.ub).all()
    assert (limits.C @ v >= limits.lo - INSIDE).all()
    assert (limits.C @ v <= limits.hi + INSIDE).all()
    assert np.abs(limits.E @ v - limits.f).max(initial=0.0) <= HELD


def least_squares(limits: QP, jacobian: Array, rate: Array, held: Tasks) -> Array:
    """Return ProxQP's v of least ‖J v − ẋ‖ inside the limits, with J v of the tasks held."""
    full = QP(limits.g.size, limits.lo.size, limits.f.size + sum(r.size for _, r in held))
    for name in ("lb", "ub", "C", "lo", "hi"):
        getattr(full, name)[:] = getattr(limits, name)
    full.E[:] = np.vstack([limits.E, *(j for j, _ in held)])
    full.f[:] = np.concatenate([limits.f, *(r for _, r in held)])
    full.H[:] = jacobian.T @ jacobian + UNDAMPED * np.eye(limits.g.size)
    full.g[:] = -jacobian.T @ rate
    solver = create("proxqp", tolerance=1e-9, max_iter=1000)
    solver.setup(full)
    return solver.solve().v


def missed(task: tuple[Array, Array], v: Array) -> float:
    jacobian, rate = task
    return float(np.linalg.norm(jacobian @ v - rate))


@seeds
def test_rows_that_are_far_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tasks = random_tasks(rng)
    n = tasks[0][0].shape[1]
    limits, _ = inside(rng, n, rows=5, equalities=0, room=1e3)
    boxed = QP(n)
    boxed.lb[:], boxed.ub[:] = limits.lb, limits.ub
    with_rows = cascade(n).solve(levels(tasks), limits)
    without = cascade(n).solve(levels(tasks), boxed)
    assert with_rows.v == pytest.approx(without.v, abs=STRICT)
    assert not with_rows.row_multiplier.any()


@seeds
@pytest.mark.parametrize("equalities", [0, 1])
def test_inside_rows_each_level_is_optimal_where_those_above_are(
    seed: int, equalities: int
) -> None:
    rng = np.random.default_rng(seed)
    tasks = random_tasks(rng)
    n = tasks[0][0].shape[1]
    limits, _ = inside(rng, n, rows=6, equalities=equalities)
    solution = cascade(n).solve(levels(tasks), limits)
    assert solution.status is SolveStatus.SOLVED
    assert_inside(solution.v, limits)
    first, second = tasks[0], tasks[1]
    best = least_squares(limits, *first, [])
    assert missed(first, solution.v) <= missed(first, best) + AGREE
    best = least_squares(limits, *second, [(first[0], first[0] @ solution.v)])
    assert missed(second, solution.v) <= missed(second, best) + AGREE


def test_rows_that_bind_have_the_multipliers_of_their_level() -> None:
    # v₁ → 1 and v₂ → 1 on two levels; v₁ + v₂ ≤ 1.5 binds the second, by 0.5.
    limits = QP(2, rows=2)
    limits.C[:], limits.hi[:] = [[1.0, 1.0], [1.0, -1.0]], [1.5, 9.0]
    one, tasks = np.ones(1), np.eye(2)
    asked = [Level(tasks[k : k + 1], one, UNDAMPED * np.eye(2)) for k in range(2)]
    solution = cascade(2).solve(asked, limits)
    assert solution.v == pytest.approx([1.0, 0.5], abs=STRICT)
    assert solution.row_multiplier == pytest.approx([0.5, 0.0], abs=STRICT)
    assert not solution.bound_multiplier.any()


def test_where_rest_is_outside_the_levels_begin_at_the_nearest_feasible_point() -> None:
    # Nothing is asked for: what is left is the projection of 0 on v₁ + v₂ ≥ 1, v₃ = 0.2.
    limits = QP(3, rows=1, equalities=1)
    limits.C[:], limits.lo[:] = [[1.0, 1.0, 0.0]], 1.0
    limits.E[:], limits.f[:] = [[0.0, 0.0, 1.0]], 0.2
    asked = [Level(np.zeros((0, 3)), np.zeros(0), np.eye(3))]
    assert cascade(3).solve([], limits).v == pytest.approx([0.5, 0.5, 0.2], abs=HELD)
    assert cascade(3).solve(asked, limits).v == pytest.approx([0.5, 0.5, 0.2], abs=HELD)


def test_equalities_that_leave_nothing_free_decide_alone() -> None:
    limits = QP(2, rows=1, equalities=3)
    limits.E[:], limits.f[:] = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.1, 0.2, 0.3]
    limits.C[:], limits.hi[:] = [[1.0, 0.0]], 1.0
    asked = [Level(np.eye(2), np.ones(2), UNDAMPED * np.eye(2))]
    assert cascade(2).solve(asked, limits).v == pytest.approx([0.1, 0.2], abs=HELD)


@pytest.mark.parametrize("equality", [False, True])
def test_limits_that_contradict_each_other_are_said(equality: bool) -> None:
    limits = QP(2, rows=0 if equality else 1, equalities=1 if equality else 0)
    limits.lb[:], limits.ub[:] = [0.2, -1.0], 1.0
    if equality:
        limits.E[:], limits.f[:] = [[1.0, 1.0]], 3.0
    else:
        limits.C[:], limits.lo[:] = [[1.0, 1.0]], 3.0
    solution = cascade(2).solve([Level(np.eye(2), np.ones(2), np.eye(2))], limits)
    assert solution.status is SolveStatus.INFEASIBLE
    assert solution.v == pytest.approx([0.2, 0.0])


def test_the_number_of_rows_may_change_from_step_to_step() -> None:
    rng = np.random.default_rng(0)
    tasks = random_tasks(rng)
    n = tasks[0][0].shape[1]
    kept = cascade(n)
    for rows in (0, 4, 1, 0, 7):
        limits, _ = inside(rng, n, rows, equalities=1)
        again = kept.solve(levels(tasks), limits).v
        assert (again == cascade(n).solve(levels(tasks), limits).v).all()


@seeds
def test_a_direction_is_kept_inside_rows_and_equalities(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits, v = inside(rng, 7, rows=5, equalities=1)
    limits.f[:] = 0.0
    limits.lo[:], limits.hi[:] = np.minimum(limits.lo, -0.05), np.maximum(limits.hi, 0.05)
    jacobian, rate = rng.normal(size=(3, 7)), rng.normal(size=3)
    solver = cascade(7)
    directed = Level(jacobian, rate, UNDAMPED * np.eye(7), (jacobian, rate))
    v = solver.solve([directed, *levels([(jacobian, rate)])[1:]], limits).v
    assert_inside(v, limits)
    assert 0.0 < solver.scale <= 1.0
    assert jacobian @ v == pytest.approx(solver.scale * rate, abs=HELD)


class FailsAfter(DAQP):
    """DAQP that gives up after some solves."""

    def __init__(self, left: list[int]) -> None:
        super().__init__()
        self._left = left

    def solve(self) -> Solution:
        solution = super().solve()
        self._left[0] -= 1
        if self._left[0] < 0:
            solution.status = SolveStatus.INFEASIBLE
        return solution


@pytest.mark.parametrize("solves", [0, 1, 2])
def test_a_level_that_fails_leaves_the_optimum_of_those_above(solves: int) -> None:
    rng = np.random.default_rng(3)
    tasks = [(rng.normal(size=(2, 6)), rng.normal(size=2)) for _ in range(3)]
    limits, _ = inside(rng, 6, rows=4, equalities=0)
    limits.lo[:], limits.hi[:] = np.minimum(limits.lo, 0.0), np.maximum(limits.hi, 0.0)
    left = [solves]
    failed = Cascade(6, lambda: FailsAfter(left)).solve(levels(tasks), limits)
    assert failed.status is SolveStatus.MAX_ITER
    assert_inside(failed.v, limits)
    above = cascade(6).solve(levels(tasks)[:solves], limits)
    assert failed.v == pytest.approx(above.v, abs=STRICT)
