"""The solver of the native engine against an independent one, every backend and its own cold start.

Its C++ tests, for the sanitizers and for memory, are in `native/tests`.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from backend_programs import (
    ILL_CONDITIONED,
    KKT_TOLERANCE,
    OBJECTIVE_TOLERANCE,
    SAME_VELOCITY,
    objective,
    programs,
)
from programs import copy_of, moving_program, random_qp, solved

from rmrc.qp.backends import BACKENDS, create
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Solution, SolveStatus

if TYPE_CHECKING:
    from rmrc._native import QPSolver
else:
    QPSolver = pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    ).QPSolver


def solver_for(qp: QP, max_iter: int = 1000) -> QPSolver:
    return QPSolver(qp.g.size, qp.lo.size, qp.f.size, max_iter)


def solve(qp: QP, solver: QPSolver | None = None) -> Solution:
    """Return the certified solution, of a new solver if there is none."""
    program = (qp.H, qp.g, qp.lb, qp.ub, qp.C, qp.lo, qp.hi, qp.E, qp.f)
    v, z, y, w, iterations, status = (solver or solver_for(qp)).solve(*program)
    solution = Solution(v, z, y, w, iterations, SolveStatus(status))
    Certificate(qp).certify(solution)
    return solution


def assert_optimal(qp: QP, solution: Solution, tolerance: float = KKT_TOLERANCE) -> None:
    assert solution.status is SolveStatus.SOLVED
    assert solution.kkt.largest <= tolerance


@pytest.mark.parametrize("with_rows", [False, True], ids=["box", "rows"])
def test_random_programs_are_solved_as_an_independent_solver_does(with_rows: bool) -> None:
    for qp, least in programs(with_rows):
        solution = solve(qp)
        assert_optimal(qp, solution)
        assert (qp.lb <= solution.v).all()
        assert (solution.v <= qp.ub).all()
        difference = abs(objective(qp, solution.v) - least)
        assert difference <= OBJECTIVE_TOLERANCE * max(1.0, abs(least))


@pytest.mark.parametrize("name", BACKENDS)
def test_every_backend_finds_the_same_velocity(name: str) -> None:
    rng, backend = np.random.default_rng(0), create(name)
    for n, rows in ((1, 0), (6, 3), (7, 8), (20, 5), (43, 10)):
        for _ in range(5):
            qp = random_qp(rng, n, rows=rows)
            qp.H[:] += np.eye(n)
            expected = solved(backend, qp).v
            np.testing.assert_allclose(solve(qp).v, expected, rtol=0.0, atol=SAME_VELOCITY)


@pytest.mark.parametrize(("n", "rows"), [(1, 0), (6, 3), (7, 0), (7, 8), (43, 0), (43, 60)])
def test_a_warm_start_equals_a_cold_one(n: int, rows: int) -> None:
    solver = None
    for qp in moving_program(np.random.default_rng(3), n, rows, steps=40):
        solver = solver or solver_for(qp)
        warm = solve(qp, solver)
        assert_optimal(qp, warm)
        np.testing.assert_allclose(warm.v, solve(qp).v, rtol=0.0, atol=SAME_VELOCITY)


def test_the_same_program_again_changes_nothing() -> None:
    for qp, _ in programs(True)[:100]:
        solver = solver_for(qp)
        cold = solve(qp, solver)
        warm = solve(qp, solver)
        assert warm.iterations == 0
        np.testing.assert_allclose(
            objective(qp, warm.v), objective(qp, cold.v), rtol=OBJECTIVE_TOLERANCE, atol=1e-12
        )
        solver.forget()
        assert solve(qp, solver).v.tobytes() == cold.v.tobytes()


def test_the_same_sequence_gives_the_same_bits() -> None:
    def run() -> list[bytes]:
        solver, found = None, []
        for qp in moving_program(np.random.default_rng(4), 20, 8, steps=20):
            solver = solver or solver_for(qp)
            solution = solve(qp, solver)
            found += [solution.v.tobytes(), solution.row_multiplier.tobytes()]
        return found

    assert run() == run()


def test_the_number_of_rows_may_change_from_solve_to_solve() -> None:
    rng, solver = np.random.default_rng(5), QPSolver(7, 20, 2)
    for rows in (3, 20, 0, 1, 1, 8):
        qp = random_qp(rng, 7, rows=rows)
        assert_optimal(qp, solve(qp, solver))


@pytest.mark.parametrize("condition", [1e8, 1e10, 1e12])
def test_an_ill_conditioned_hessian_is_solved(condition: float) -> None:
    rng = np.random.default_rng(10)
    for n in (6, 7, 20, 43):
        for _ in range(10):
            qp = random_qp(rng, n, rows=n // 3)
            basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
            qp.H[:] = (basis * np.geomspace(1.0, 1.0 / condition, n)) @ basis.T
            qp.H[:] = 0.5 * (qp.H + qp.H.T)
            assert_optimal(qp, solve(qp))


@pytest.mark.parametrize("damping", [1e-8, 1e-12])
def test_a_hessian_that_is_all_but_singular_is_solved(damping: float) -> None:
    rng = np.random.default_rng(11)
    for n in (2, 7, 16, 43):
        for _ in range(20):
            qp = random_qp(rng, n, rows=n // 2)
            jacobian = rng.normal(size=(max(1, n // 3), n))
            qp.H[:] = jacobian.T @ jacobian + damping * np.eye(n)
            qp.g[:] = rng.normal(size=n)  # it pulls where H does not resist, up to the limits
            assert_optimal(qp, solve(qp), ILL_CONDITIONED)


def test_rows_that_depend_on_each_other_are_no_trouble() -> None:
    rng = np.random.default_rng(12)
    for n in (3, 7, 16):
        for _ in range(30):
            qp = QP(n, rows=8, equalities=4)
            plain = random_qp(rng, n)
            qp.H[:], qp.g[:] = plain.H, 10.0 * plain.g
            feasible = rng.uniform(-0.5, 0.5, size=n)
            qp.lb[:], qp.ub[:] = -1.0, 1.0
            qp.lb[0] = qp.ub[0] = feasible[0]
            qp.E[:2] = rng.normal(size=(2, n)) * [[1.0], [0.0]]  # the second is a row of zeros
            qp.E[2:] = qp.E[0] * [[3.0], [-1.0]]
            qp.f[:] = qp.E @ feasible
            qp.C[:3] = rng.normal(size=n)  # three times the same row
            qp.C[3] = -qp.C[0]
            qp.C[4, 0] = qp.C[5, 1] = 1.0  # a variable that is fixed, and a bound once more
            qp.C[6] = qp.E[0]
            activity = qp.C @ feasible
            qp.lo[:], qp.hi[:] = activity - 0.1, activity + 0.1
            qp.lo[7], qp.hi[7] = -np.inf, np.inf  # a row of zeros, and no limit
            qp.lo[5], qp.hi[5] = -1.0, 1.0
            assert_optimal(qp, solve(qp))


def test_a_velocity_without_freedom_is_found() -> None:
    qp = random_qp(np.random.default_rng(13), 7, rows=3)
    feasible = np.clip(np.zeros(7), qp.lb, qp.ub)
    qp.lb[:] = qp.ub[:] = feasible
    qp.lo[:] = qp.hi[:] = qp.C @ feasible
    np.testing.assert_array_equal(solve(qp).v, feasible)


def contradict_bounds(qp: QP) -> None:
    qp.lb[0], qp.ub[0] = 1.0, 0.5


def contradict_rows(qp: QP) -> None:
    qp.lo[0], qp.hi[0] = np.abs(qp.C[0]) @ np.maximum(np.abs(qp.lb), np.abs(qp.ub)) + 1e-3, np.inf


def contradict_equalities(qp: QP) -> None:
    qp.E[1], qp.f[1] = qp.E[0], qp.f[0] + 1e-3


def contradict_by_nothing(qp: QP) -> None:
    qp.C[0], qp.lo[0], qp.hi[0] = 0.0, 1e-3, np.inf


def contradict_beyond_numbers(qp: QP) -> None:
    qp.lb[0] = qp.ub[0] = np.inf


def spoil(name: str, value: float) -> Callable[[QP], None]:
    def change(qp: QP) -> None:
        getattr(qp, name).flat[0] = value

    change.__name__ = f"{name} {value}"
    return change


INFEASIBLE = (
    contradict_bounds,
    contradict_rows,
    contradict_equalities,
    contradict_by_nothing,
    contradict_beyond_numbers,
)
BROKEN = [
    *(spoil(name, np.nan) for name in ("H", "g", "lb", "ub", "C", "lo", "hi", "E", "f")),
    *(spoil(name, np.inf) for name in ("H", "g", "C", "E", "f")),
]


@pytest.mark.parametrize(
    ("change", "status"),
    [(change, SolveStatus.INFEASIBLE) for change in INFEASIBLE]
    + [(change, SolveStatus.FAILED) for change in BROKEN],
)
def test_what_has_no_solution_says_so_and_leaves_no_trace(
    change: Callable[[QP], None], status: SolveStatus
) -> None:
    rng = np.random.default_rng(14)
    good = QP(7, rows=4, equalities=2)
    while not good.f.any():  # one random program in three has equalities
        good = random_qp(rng, 7, rows=4)
    solver, bad = solver_for(good), copy_of(good)
    change(bad)
    fresh = solve(good, solver)
    for _ in range(2):
        solution = solve(bad, solver)
        assert solution.status is status
        assert not solution.bound_multiplier.any()
        assert not solution.row_multiplier.any()
        assert not solution.equality_multiplier.any()
    again = solve(good, solver)
    assert_optimal(good, again)
    assert again.v.tobytes() == fresh.v.tobytes()


def test_a_limit_on_iterations_is_kept() -> None:
    stopped = 0
    for qp, _ in programs(True)[:60]:
        needed = solve(qp).iterations
        assert_optimal(qp, solve(qp, solver_for(qp, max_iter=max(1, needed))))
        if needed > 1:
            solution = solve(qp, solver_for(qp, max_iter=needed - 1))
            assert solution.status is SolveStatus.MAX_ITER
            assert solution.iterations <= needed - 1
            stopped += 1
    assert stopped > 20


def test_a_solution_is_not_overwritten_by_the_next() -> None:
    qp = random_qp(np.random.default_rng(15), 7, rows=2)
    solver = solver_for(qp)
    first = solve(qp, solver)
    kept = first.v.copy()
    qp.g[:] = -qp.g
    assert not np.array_equal(solve(qp, solver).v, kept)
    np.testing.assert_array_equal(first.v, kept)


def test_arrays_that_do_not_fit_are_refused() -> None:
    qp = random_qp(np.random.default_rng(16), 7, rows=2)
    with pytest.raises(ValueError, match="fit"):
        solve(qp, QPSolver(6, 2, 0))
    with pytest.raises(ValueError, match="room"):
        solve(qp, QPSolver(7, 1, 0))
    with pytest.raises(ValueError, match="range"):
        QPSolver(0)


def beyond_a_double() -> list[tuple[np.ndarray, ...]]:
    """Return H, g, lb and ub of programs whose way to a bound has no length."""
    off = 9.783267071805483e-19
    return [
        (
            np.array([[1e-320, off], [off, 7.483329573704379e-19]]),
            np.array([16.78487109644893, 80.8144389661612]),
            np.array([-0.000880222938160904, -0.004431981058865923]),
            np.array([5.361682141447186, 70.08871684328189]),
        ),
        (np.diag([1.0, -1.0]), np.ones(2), np.full(2, -1.0), np.ones(2)),
        (np.diag([5e-324, 5e-324]), np.ones(2), np.full(2, -1.0), np.ones(2)),
        (np.zeros((2, 2)), np.ones(2), np.full(2, -1.0), np.ones(2)),
        (np.eye(2), np.full(2, 1e300), np.full(2, -1e-300), np.full(2, 1e-300)),
        (np.full((2, 2), 1e300), np.ones(2), np.full(2, -1.0), np.ones(2)),
        (np.full((2, 2), np.nan), np.ones(2), np.full(2, -1.0), np.ones(2)),
        (np.eye(2), np.ones(2), np.full(2, np.nan), np.ones(2)),
    ]


@pytest.mark.parametrize("given", beyond_a_double())
def test_what_has_no_optimum_is_said_and_forgotten(given: tuple[np.ndarray, ...]) -> None:
    H, g, lb, ub = given
    none = (np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    sane = (np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([4.0, -0.2]), -np.ones(2), np.ones(2))
    cold = QPSolver(2).solve(*sane, *none)
    solver = QPSolver(2)
    solver.solve(*sane, *none)
    v, *_, status = solver.solve(H, g, lb, ub, *none)
    assert status in {each.value for each in SolveStatus}
    assert np.isfinite(v).all()
    assert status == "solved" or not v.any()
    again = solver.solve(*sane, *none)
    assert again[5] == cold[5] == "solved"
    assert np.abs(again[0] - cold[0]).max() < SAME_VELOCITY
