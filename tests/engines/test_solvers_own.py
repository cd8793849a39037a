"""What the solvers do by themselves, which our settings and checks are there for."""

from typing import Any

import daqp
import numpy as np
import osqp
import pytest
import qpsolvers
from backend_programs import (
    BUILDERS,
    KKT_TOLERANCE,
    OBJECTIVE_TOLERANCE,
    SAME_VELOCITY,
    Array,
    objective,
    programs,
)
from programs import random_qp, solved
from proxsuite import proxqp  # pyright: ignore[reportMissingImports]
from scipy.sparse import csc_matrix

from rmrc.errors import SolverError
from rmrc.qp.backends import Backend, create
from rmrc.qp.program import QP, SolveStatus


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


def test_daqp_solves_with_exactly_the_iterations_it_needs() -> None:
    qp = random_qp(np.random.default_rng(9), 7, "vertex")
    needed = solved(create("daqp"), qp).iterations
    assert needed > 2
    assert solved(create("daqp", max_iter=needed), qp).status is SolveStatus.SOLVED
    stopped = solved(create("daqp", max_iter=needed - 1), qp)
    assert stopped.status is SolveStatus.MAX_ITER
    # What DAQP leaves in v before its last iteration is not a velocity.
    np.testing.assert_array_equal(stopped.v, np.clip(np.zeros(7), qp.lb, qp.ub))


# What the solvers do by themselves, and why we ask for something else.


def test_daqp_by_default_lets_a_limit_be_passed() -> None:
    qp = QP(1)
    qp.H[:], qp.g[:], qp.lb[:], qp.ub[:] = 1.0, -(1.0 + 5e-7), -1.0, 1.0
    v, _, flag, _ = daqp.solve(qp.H, qp.g, np.zeros((0, 1)), qp.ub, qp.lb)
    assert flag == 1
    assert v[0] > 1.0 + 1e-7
    ours = create("daqp")
    ours.setup(qp)
    assert ours.solve().v[0] == 1.0  # before the certificate has clipped it


def test_daqp_by_default_takes_a_limit_that_is_not_a_number() -> None:
    qp = QP(1)
    qp.H[:], qp.g[:], qp.lb[:], qp.ub[:] = 1.0, -5.0, -1.0, np.nan
    _, _, flag, _ = daqp.solve(qp.H, qp.g, np.zeros((0, 1)), qp.ub, qp.lb)
    assert flag == 1
    assert solved(create("daqp"), qp).status is SolveStatus.FAILED


def test_daqp_goes_wrong_where_an_active_limit_becomes_infinite() -> None:
    qp = QP(2)
    qp.H[:], qp.g[:] = np.diag([2.0, 5.0]), [-5.0, 8.0]
    qp.lb[:], qp.ub[:] = -1.0, 1.0
    ours = create("daqp")
    solved(ours, qp)
    lower, upper = qp.lb.copy(), qp.ub.copy()
    model = daqp.Model()
    model.setup(qp.H, qp.g, np.zeros((0, 2)), upper, lower)
    model.solve()
    upper[0] = qp.ub[0] = np.inf
    model.update(qp.H, qp.g, None, upper, lower)
    v, _, flag, _ = model.solve()
    assert flag == 1
    assert np.isnan(v).any()
    ours.update(qp)
    np.testing.assert_allclose(ours.solve().v, [2.5, -1.0], rtol=0.0, atol=SAME_VELOCITY)


def test_proxqp_by_default_calls_solved_what_is_far_from_the_optimum() -> None:
    # Its residuals leave complementarity out: a feasible point with any balanced multipliers does.
    qp = QP(1, rows=1)
    qp.H[:], qp.g[:], qp.lb[:], qp.ub[:], qp.C[:], qp.lo[:] = 1.0, 2.0, -1.0, 1.0, 1.0, 0.5
    solver = proxqp.dense.QP(1, 0, 1, box_constraints=True)
    solver.settings.eps_abs, solver.settings.eps_rel = 1e-8, 0.0
    solver.init(qp.H, qp.g, qp.E, qp.f, qp.C, qp.lo, qp.hi, qp.lb, qp.ub)
    solver.solve()
    assert solver.results.info.status == proxqp.PROXQP_SOLVED
    assert solver.results.x[0] > 0.6
    assert solved(create("proxqp"), qp).v[0] == pytest.approx(0.5, abs=SAME_VELOCITY)


def raw_osqp(qp: QP, **settings: float) -> tuple[Array, str]:
    solver = osqp.OSQP()
    rows = csc_matrix(np.vstack([np.eye(qp.g.size), qp.C]))
    lower, upper = np.concatenate([qp.lb, qp.lo]), np.concatenate([qp.ub, qp.hi])
    solver.setup(csc_matrix(np.triu(qp.H)), qp.g, rows, lower, upper, verbose=False, **settings)
    result = solver.solve(raise_error=False)
    return np.array(result.x), result.info.status


def test_osqp_by_default_lets_a_velocity_cap_be_passed() -> None:
    # A step of 2 ms whose variable is Δq: the cap of 1 rad/s is 0.002 rad.
    dt, cap, wanted = 0.002, 1.0, 10.0
    step = QP(1)
    step.H[:], step.g[:], step.lb[:], step.ub[:] = 1.0, -wanted * dt, -cap * dt, cap * dt
    displacement, status = raw_osqp(step)
    assert status == "solved"
    assert displacement[0] / dt > 1.1 * cap
    rate = QP(1)
    rate.H[:], rate.g[:], rate.lb[:], rate.ub[:] = 1.0, -wanted, -cap, cap
    assert solved(create("osqp"), rate).v[0] == cap


def test_osqp_polishing_writes_to_the_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    raw_osqp(random_qp(np.random.default_rng(11), 7, "inside"), polishing=True)
    assert "olish" in capfd.readouterr().out


def test_osqp_by_default_calls_an_ill_conditioned_program_unbounded() -> None:
    qp = QP(2)
    qp.H[:], qp.g[:] = np.diag([1.0, 1e-8]), [1.0, 1e-3]
    assert raw_osqp(qp, eps_abs=1e-6, eps_rel=0.0)[1] == "dual infeasible"
    np.testing.assert_allclose(solved(create("osqp"), qp).v, [-1.0, -1e5], rtol=SAME_VELOCITY)


def test_osqp_fills_an_infeasible_solution_with_a_number() -> None:
    qp = QP(1, rows=1)
    qp.H[:], qp.lb[:], qp.ub[:], qp.C[:], qp.lo[:], qp.hi[:] = 1.0, -1.0, 1.0, 1.0, 2.0, 3.0
    x, status = raw_osqp(qp)
    assert status == "primal infeasible"
    assert x[0] > 1e9
    assert solved(create("osqp"), qp).v[0] == 0.0


def borrow(monkeypatch: pytest.MonkeyPatch, name: str, sparse: bool = False) -> list[dict]:
    """Give qpsolvers a solver of that name, DAQP in truth; return the options of its calls."""
    calls: list[dict] = []
    real = qpsolvers.solvers.solve_function["daqp"]

    def solve(problem: qpsolvers.Problem, **options: object) -> qpsolvers.Solution:
        calls.append({**options, "sparse": problem.has_sparse})
        return real(problem)

    monkeypatch.setitem(qpsolvers.solvers.solve_function, name, solve)
    monkeypatch.setattr(qpsolvers, "available_solvers", [*qpsolvers.available_solvers, name])
    if not sparse:
        monkeypatch.setattr(qpsolvers, "dense_solvers", [*qpsolvers.dense_solvers, name])
    return calls


@pytest.mark.parametrize("sparse", [False, True])
def test_any_solver_of_qpsolvers_is_a_backend(
    monkeypatch: pytest.MonkeyPatch, sparse: bool
) -> None:
    calls = borrow(monkeypatch, "clarabel", sparse)
    backend = create("clarabel", max_iter=30, tolerance=1e-7)
    for qp, least in programs(True)[:50]:
        solution = solved(backend, qp)
        assert solution.kkt.largest <= KKT_TOLERANCE
        assert objective(qp, solution.v) <= least + OBJECTIVE_TOLERANCE * max(1.0, abs(least))
    assert calls[0]["max_iter"] == 30
    assert calls[0]["tol_feas"] == 1e-7
    assert calls[0]["sparse"] is sparse


@pytest.mark.parametrize("settings", [{"max_iter": 5}, {"tolerance": 1e-6}])
def test_a_setting_that_a_solver_does_not_have_is_refused(
    monkeypatch: pytest.MonkeyPatch, settings: dict[str, Any]
) -> None:
    borrow(monkeypatch, "quadprog")
    with pytest.raises(SolverError, match=f"'quadprog' takes no {next(iter(settings))}"):
        create("quadprog", **settings)


def test_a_solver_that_raises_is_a_failed_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    borrow(monkeypatch, "quadprog")

    def fail(problem: qpsolvers.Problem, **options: object) -> None:
        raise ZeroDivisionError

    backend = create("quadprog")
    monkeypatch.setitem(qpsolvers.solvers.solve_function, "quadprog", fail)
    solution = solved(backend, random_qp(np.random.default_rng(13), 3))
    assert solution.status is SolveStatus.FAILED
    assert not solution.v.any()


@pytest.mark.parametrize("length", [1.0, 1e-4, 6e-7, 1e-9])
def test_daqp_keeps_a_row_of_any_length(length: float) -> None:
    """It ignored rows shorter than 3e-6: the command was then shortened to nothing for them."""
    qp = QP(3, 1)
    qp.H[:], qp.g[:], qp.lb[:], qp.ub[:] = np.eye(3), [-1.0, -1.0, 0.0], -5.0, 5.0
    qp.C[0], qp.lo[0], qp.hi[0] = [length, 0.0, 0.0], -np.inf, 0.5 * length
    backend = create("daqp")
    backend.setup(qp)
    for _ in range(2):
        solution = backend.solve()
        assert solution.v == pytest.approx([0.5, 1.0, 0.0], abs=1e-9)
        assert length * solution.row_multiplier[0] == pytest.approx(0.5, abs=1e-9)
        backend.update(qp)
