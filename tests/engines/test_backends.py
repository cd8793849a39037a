"""Every backend against an independent solver and its own fresh start, and where it must fail."""

from collections.abc import Callable
from functools import cache
from typing import Any

import daqp
import numpy as np
import osqp
import pytest
import qpsolvers
from numpy.typing import NDArray
from programs import copy_into, copy_of, moving_program, random_qp, solved
from proxsuite import proxqp  # pyright: ignore[reportMissingImports]
from scipy.linalg import null_space
from scipy.optimize import nnls
from scipy.sparse import csc_matrix

from rmrc.errors import SolverError
from rmrc.qp.backends import BACKENDS, Backend, create
from rmrc.qp.backends.qpsolvers_adapter import QpsolversAdapter
from rmrc.qp.certificate import Certificate
from rmrc.qp.polish import Polish
from rmrc.qp.program import QP, UNCERTIFIED, Solution, SolveStatus

Array = NDArray[np.float64]

KKT_TOLERANCE = 1e-8
"""What every backend must reach: 1e-8 rad/s is far below what a robot can measure."""
OBJECTIVE_TOLERANCE = 1e-8
"""Of the largest of 1 and |objective|; the independent solver is good for about 1e-11."""
SAME_VELOCITY = 1e-8
"""Two solutions of one well-conditioned program: KKT residuals of 1e-8 divided by λ_min(H) ≥ 1."""
ILL_CONDITIONED = 1e-6
"""KKT residual with cond(H) = 1e10, where ten of a float's sixteen digits are lost."""

SIZES = (1, 6, 7, 1, 6, 7, 2, 3, 12, 20, 30, 43)
KINDS = ("plain", "vertex", "fixed", "inside", "open")
COUNT = 500

BUILDERS: dict[str, Callable[[], Backend]] = {
    **{name: lambda name=name: create(name) for name in BACKENDS},
    "adapter": lambda: QpsolversAdapter("daqp"),
}
FIRST_ORDER = ("proxqp", "osqp")


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


@cache
def programs(with_rows: bool) -> list[tuple[QP, float]]:
    """Return 500 seeded programs, each with its least objective."""
    rng = np.random.default_rng(2 if with_rows else 1)
    found = []
    for k in range(COUNT):
        n = SIZES[k % len(SIZES)]
        rows = int(rng.integers(1, n + 2)) if with_rows else 0
        qp = random_qp(rng, n, KINDS[k % len(KINDS)], rows)
        found.append((qp, objective(qp, least_distance_solution(qp))))
    return found


def objective(qp: QP, v: Array) -> float:
    return float(0.5 * v @ qp.H @ v + qp.g @ v)


def least_distance_solution(qp: QP) -> Array:
    """Return the optimum by non-negative least squares, which shares nothing with any backend.

    With H = LLᵀ and x = Lᵀv + L⁻¹g the program is to find the shortest x with G x ≥ h, which is
    read off the residual of one NNLS problem (Lawson and Hanson, Solving Least Squares Problems,
    1974, chapter 23). What is fixed by lb = ub or E v = f is eliminated first.
    """
    n = qp.g.size
    fixed = qp.lb == qp.ub
    equal = np.vstack([np.eye(n)[fixed], qp.E])
    values = np.concatenate([qp.lb[fixed], qp.f])
    start: Array = np.linalg.lstsq(equal, values, rcond=None)[0].astype(float)
    basis = null_space(equal) if len(equal) else np.eye(n)
    if not basis.size:
        return start
    limits = np.concatenate([qp.lb, -qp.ub, qp.lo, -qp.hi])
    real = np.isfinite(limits) & ~np.concatenate([fixed, fixed, np.zeros(2 * qp.lo.size, bool)])
    rows = np.vstack([np.eye(n), -np.eye(n), qp.C, -qp.C])[real]
    root = np.linalg.cholesky(basis.T @ qp.H @ basis)
    offset = np.linalg.solve(root, basis.T @ (qp.g + qp.H @ start))
    if not rows.size:
        return start - basis @ np.linalg.solve(root.T, offset)
    normals = np.linalg.solve(root, (rows @ basis).T)
    levels = limits[real] - rows @ start + offset @ normals
    scale, x = 1.0, offset
    for _ in range(3):  # the residual is accurate once x is scaled to length 1
        matrix = np.vstack([normals, levels / scale])
        target = np.append(np.zeros(offset.size), 1.0)
        residual = matrix @ nnls(matrix, target, maxiter=100 * n)[0] - target
        x = -scale * residual[:-1] / residual[-1]
        scale = max(float(np.linalg.norm(x)), 1e-3)
    return start + basis @ np.linalg.solve(root.T, x - offset)


@pytest.mark.parametrize("with_rows", [False, True], ids=["box", "rows"])
def test_random_programs_are_solved_as_an_independent_solver_does(
    backend: Backend, with_rows: bool
) -> None:
    for qp, least in programs(with_rows):
        solution = solved(backend, qp)
        assert solution.status is SolveStatus.SOLVED
        assert solution.kkt.largest <= KKT_TOLERANCE
        assert (qp.lb <= solution.v).all()
        assert (solution.v <= qp.ub).all()
        difference = abs(objective(qp, solution.v) - least)
        assert difference <= OBJECTIVE_TOLERANCE * max(1.0, abs(least))


def test_the_random_programs_cover_what_is_hard() -> None:
    for with_rows in (False, True):
        pairs = [(qp, solved(create("daqp"), qp)) for qp, _ in programs(with_rows)]
        at_bound = [np.isclose(s.v, qp.lb) | np.isclose(s.v, qp.ub) for qp, s in pairs]
        pushed = [s.bound_multiplier != 0.0 for _, s in pairs]
        assert {qp.g.size for qp, _ in pairs} >= {1, 6, 7, 43}
        assert any(at.size == 43 and at.all() for at in at_bound) or with_rows
        assert any((at & ~z).any() for at, z in zip(at_bound, pushed, strict=True))  # weakly active
        assert (
            sum(not s.bound_multiplier.any() and not s.row_multiplier.any() for _, s in pairs) > 20
        )
        assert sum((qp.lb == qp.ub).any() for qp, _ in pairs) > 50
        assert sum(np.isinf(qp.lb).any() for qp, _ in pairs) > 50
    assert sum(qp.f.size > 0 for qp, _ in pairs) > 50
    assert sum(np.count_nonzero(s.row_multiplier) > 1 for _, s in pairs) > 50
    twice = [(qp.C[: qp.lo.size // 4] @ s.v, qp) for qp, s in pairs if qp.lo.size >= 4]
    active = [
        np.isclose(rows, qp.lo[: rows.size]) | np.isclose(rows, qp.hi[: rows.size])
        for rows, qp in twice
    ]
    assert sum(rows.any() for rows in active) > 50


@pytest.mark.parametrize(("n", "rows"), [(1, 0), (6, 3), (7, 0), (7, 8), (43, 10)])
def test_an_update_in_place_equals_a_fresh_solve(backend: Backend, n: int, rows: int) -> None:
    rng = np.random.default_rng(3)
    for k, qp in enumerate(moving_program(rng, n, rows, steps=30)):
        if k == 0:
            backend.setup(qp)
        else:
            backend.update(qp)
        warm = backend.solve()
        certificate = Certificate(qp)
        assert warm.status is SolveStatus.SOLVED
        assert certificate.certify(warm) <= KKT_TOLERANCE
        fresh = solved(create("daqp"), qp)
        np.testing.assert_allclose(warm.v, fresh.v, rtol=0.0, atol=SAME_VELOCITY)


def test_an_update_to_an_unrelated_program_equals_a_fresh_solve(backend: Backend) -> None:
    rng = np.random.default_rng(14)
    for n, rows in ((1, 0), (7, 0), (7, 3), (20, 3)):
        qp = random_qp(rng, n, "plain", rows)
        backend.setup(qp)
        for scale in (1.0, 1e-3, 1e3, 1.0):
            backend.solve()
            other = random_qp(rng, n, "plain", rows)
            copy_into(qp, other)
            qp.H[:], qp.g[:] = scale * (qp.H + np.eye(n)), scale * qp.g
            backend.update(qp)
            solution = backend.solve()
            assert solution.status is SolveStatus.SOLVED
            assert Certificate(qp).certify(solution) <= KKT_TOLERANCE * max(1.0, scale)
            fresh = solved(create("daqp"), qp)
            np.testing.assert_allclose(solution.v, fresh.v, rtol=0.0, atol=SAME_VELOCITY)


def test_the_same_sequence_gives_the_same_bits(backend: Backend) -> None:
    def run() -> list[bytes]:
        rng, found = np.random.default_rng(4), []
        for k, qp in enumerate(moving_program(rng, 7, 3, steps=20)):
            backend.update(qp) if k else backend.setup(qp)
            solution = backend.solve()
            found += [solution.v.tobytes(), solution.row_multiplier.tobytes()]
        return found

    assert run() == run()


def test_a_solution_is_not_overwritten_by_the_next(backend: Backend) -> None:
    qp = random_qp(np.random.default_rng(5), 7, rows=2)
    first = solved(backend, qp)
    kept = [first.v.copy(), first.bound_multiplier.copy(), first.row_multiplier.copy()]
    qp.g[:] = -qp.g
    backend.update(qp)
    second = backend.solve()
    assert not np.array_equal(second.v, first.v)
    for before, after in zip(
        kept, [first.v, first.bound_multiplier, first.row_multiplier], strict=True
    ):
        np.testing.assert_array_equal(before, after)


def test_a_second_identical_solve_takes_no_more_iterations(backend: Backend) -> None:
    for qp, _ in programs(True)[:60]:
        backend.setup(qp)
        first = backend.solve()
        backend.update(qp)
        assert backend.solve().iterations <= first.iterations


def test_warm_starts_save_iterations() -> None:
    # Else "no more iterations" would also hold of a backend that starts cold every time.
    for name in BACKENDS:
        backend, cold, warm = create(name), 0, 0
        for qp, _ in programs(True)[:60]:
            backend.setup(qp)
            cold += backend.solve().iterations
            backend.update(qp)
            warm += backend.solve().iterations
        assert warm < cold, name


@pytest.mark.parametrize("size", [1, 7])
def test_another_program_needs_no_setup_call(backend: Backend, size: int) -> None:
    backend.setup(random_qp(np.random.default_rng(6), 6, rows=2))
    backend.solve()
    other = random_qp(np.random.default_rng(7), size)
    backend.update(other)
    solution = backend.solve()
    assert Certificate(other).certify(solution) <= KKT_TOLERANCE


def test_a_solve_before_setup_is_refused(backend: Backend) -> None:
    with pytest.raises(SolverError, match="setup"):
        backend.solve()


def contradict_rows(qp: QP) -> None:
    reach = np.abs(qp.C[0]) @ np.maximum(np.abs(qp.lb), np.abs(qp.ub))
    qp.lo[0], qp.hi[0] = reach + 1.0, np.inf


def contradict_bounds(qp: QP) -> None:
    qp.lb[0], qp.ub[0] = 1.0, 0.5


def contradict_equalities(qp: QP) -> None:
    qp.E[1], qp.f[1] = qp.E[0], qp.f[0] + 1.0


def spoil_gradient(qp: QP) -> None:
    qp.g[-1] = np.nan


def spoil_hessian(qp: QP) -> None:
    qp.H[0, 0] = np.inf


def spoil_bound(qp: QP) -> None:
    qp.ub[0] = np.nan


def spoil_row(qp: QP) -> None:
    qp.C[0, 0] = np.nan


INFEASIBLE = (contradict_rows, contradict_bounds, contradict_equalities)
BROKEN = (spoil_gradient, spoil_hessian, spoil_bound, spoil_row)


def program_with_everything() -> QP:
    rng = np.random.default_rng(8)
    qp = QP(7, rows=3, equalities=2)
    source = random_qp(rng, 7)
    qp.H[:], qp.g[:], qp.lb[:], qp.ub[:] = source.H + np.eye(7), source.g, source.lb, source.ub
    inside = 0.5 * (qp.lb + qp.ub)
    qp.C[:], qp.E[:] = rng.normal(size=(3, 7)), rng.normal(size=(2, 7))
    qp.lo[:], qp.f[:] = qp.C @ inside - 0.1, qp.E @ inside
    return qp


@pytest.mark.parametrize("spoil", INFEASIBLE + BROKEN)
def test_what_cannot_be_solved_is_a_status_and_leaves_no_trace(
    backend: Backend, spoil: Callable[[QP], None]
) -> None:
    good = program_with_everything()
    qp = copy_of(good)
    fresh = solved(backend, copy_of(good))
    backend.setup(qp)
    backend.solve()
    spoil(qp)
    for _ in range(2):
        backend.update(qp)
        bad = backend.solve()
        assert bad.status is not SolveStatus.SOLVED
        assert np.isfinite(bad.v).all()
        Certificate(qp).certify(bad)
        assert bad.kkt.largest > KKT_TOLERANCE
    copy_into(qp, good)
    backend.update(qp)
    again = backend.solve()
    Certificate(qp).certify(again)
    assert again.status is SolveStatus.SOLVED
    # Bit for bit what a backend says that has never seen the bad program.
    assert again.v.tobytes() == fresh.v.tobytes()
    assert again.iterations == fresh.iterations


@pytest.mark.parametrize("name", BACKENDS)
def test_a_solve_that_was_stopped_is_not_taken_up_again(name: str) -> None:
    backend = create(name, max_iter=1)
    stopped = 0
    for qp, _ in programs(True)[:60]:
        backend.setup(qp)
        first, second = backend.solve(), backend.solve()
        if first.status is SolveStatus.MAX_ITER:
            stopped += 1
            np.testing.assert_allclose(second.v, first.v, rtol=0.0, atol=SAME_VELOCITY)
    assert stopped > 5


class NotANumber(Backend):
    """A backend that calls NaN a solution."""

    def __init__(self) -> None:
        super().__init__(polished=False)

    def _load(self, qp: QP) -> None:
        pass

    def _refresh(self, qp: QP) -> None:
        pass

    def _run(self, qp: QP, seconds: float) -> Solution:
        solution = Solution.at_rest(qp, SolveStatus.SOLVED, 3)
        solution.v[0] = np.nan
        return solution


def test_a_velocity_that_is_not_a_number_does_not_leave_a_backend() -> None:
    solution = solved(NotANumber(), random_qp(np.random.default_rng(15), 7))
    assert solution.status is SolveStatus.FAILED
    assert solution.iterations == 3
    assert np.isfinite(solution.v).all()


@pytest.mark.parametrize("name", ["daqp", "osqp"])
@pytest.mark.parametrize("contradict", INFEASIBLE)
def test_a_contradiction_is_called_infeasible(name: str, contradict: Callable[[QP], None]) -> None:
    qp = program_with_everything()
    contradict(qp)
    assert solved(create(name), qp).status is SolveStatus.INFEASIBLE


@pytest.mark.parametrize("name", BACKENDS)
def test_a_limit_on_iterations_is_kept(name: str) -> None:
    stopped = 0
    for qp, _ in programs(True)[:60]:
        needed = solved(create(name), qp).iterations
        solution = solved(create(name, max_iter=1), qp)
        assert solution.iterations <= 1
        if needed > 1:
            assert solution.status in (SolveStatus.MAX_ITER, SolveStatus.SOLVED)
            # A polished point may be the optimum all the same; then the certificate says so.
            assert solution.status is not SolveStatus.SOLVED or solution.kkt.largest <= 1e-6
        assert np.isfinite(solution.v).all()
        stopped += solution.status is SolveStatus.MAX_ITER
    assert stopped > 5


def test_daqp_solves_with_exactly_the_iterations_it_needs() -> None:
    qp = random_qp(np.random.default_rng(9), 7, "vertex")
    needed = solved(create("daqp"), qp).iterations
    assert needed > 2
    assert solved(create("daqp", max_iter=needed), qp).status is SolveStatus.SOLVED
    stopped = solved(create("daqp", max_iter=needed - 1), qp)
    assert stopped.status is SolveStatus.MAX_ITER
    # What DAQP leaves in v before its last iteration is not a velocity.
    np.testing.assert_array_equal(stopped.v, np.clip(np.zeros(7), qp.lb, qp.ub))


@pytest.mark.parametrize(
    ("condition", "tolerance"), [(1e8, KKT_TOLERANCE), (1e10, ILL_CONDITIONED)]
)
def test_an_ill_conditioned_hessian_is_solved(
    backend: Backend, condition: float, tolerance: float
) -> None:
    rng = np.random.default_rng(10)
    for n in (6, 7, 20, 43):
        for _ in range(10):
            qp = random_qp(rng, n, "plain", rows=n // 3)
            qp.H[:] = 0.0
            basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
            qp.H[:] = (basis * np.geomspace(1.0, 1.0 / condition, n)) @ basis.T
            qp.H[:] = 0.5 * (qp.H + qp.H.T)
            solution = solved(backend, qp)
            assert solution.status is SolveStatus.SOLVED
            assert solution.kkt.largest <= tolerance


def test_nothing_is_written_to_the_standard_output(
    backend: Backend, capfd: pytest.CaptureFixture[str]
) -> None:
    for spoil in (None, *INFEASIBLE, *BROKEN):
        qp = program_with_everything()
        if spoil:
            spoil(qp)
        solved(backend, qp)
        backend.update(qp)
        backend.solve()
    solved(backend, random_qp(np.random.default_rng(11), 7, "inside"))
    assert capfd.readouterr() == ("", "")


def test_a_polished_solution_is_never_worse() -> None:
    rng = np.random.default_rng(12)
    for qp, _ in programs(True)[:100]:
        rough = Solution.at_rest(qp, SolveStatus.MAX_ITER)
        for part in (rough.v, rough.bound_multiplier, rough.row_multiplier):
            part[:] = rng.normal(size=part.size)
        before = Certificate(qp).certify(rough)
        better = Polish(qp).improve(rough)
        assert better.kkt.largest <= before
        optimal = better.kkt.largest <= KKT_TOLERANCE
        assert (better.status is SolveStatus.SOLVED) >= optimal
        if better.status is SolveStatus.SOLVED:
            assert better.kkt.largest <= KKT_TOLERANCE * max(1.0, np.abs(qp.g).max())


def test_a_polished_solution_does_not_depend_on_the_way_to_it() -> None:
    for qp, _ in programs(False)[:: len(KINDS)]:  # plain boxes: nothing is active by a hair
        polish, exact = Polish(qp), solved(create("daqp"), qp)
        other = solved(create("daqp"), qp)
        other.v *= 1.0 + 1e-13
        assert polish.improve(exact).v.tobytes() == polish.improve(other).v.tobytes()


@pytest.mark.parametrize("name", FIRST_ORDER)
def test_polishing_is_what_makes_a_coarse_tolerance_do(name: str) -> None:
    coarse, bare = 0.0, 0.0
    for qp, _ in programs(True)[:60]:
        backend = create(name, tolerance=1e-4)
        coarse = max(coarse, solved(backend, qp).kkt.largest)
        bare = max(bare, Certificate(qp).certify(backend._run(qp, np.inf)))
    assert bare > 1e-5
    assert coarse <= KKT_TOLERANCE


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


# The table, and what it says to a wrong name.


def test_an_unknown_backend_is_named_with_those_there_are() -> None:
    with pytest.raises(SolverError, match=r"'dqp'; did you mean 'daqp'.*daqp, proxqp, osqp"):
        create("dqp")


@pytest.mark.parametrize(
    ("name", "words"),
    [("gurobi", r"pip install 'qpsolvers\[gurobi\]'"), ("hpipm", "documentation")],
)
def test_a_backend_that_is_not_installed_says_how_to_install_it(name: str, words: str) -> None:
    if name in qpsolvers.available_solvers:
        pytest.skip(f"{name} is installed here")
    with pytest.raises(SolverError, match=words):
        create(name)


@pytest.mark.parametrize(
    "settings", [{"max_iter": 0}, {"tolerance": 0.0}, {"tolerance": -1.0}, {"tolerance": np.nan}]
)
def test_a_setting_out_of_range_is_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(SolverError, match=next(iter(settings))):
        create("daqp", **settings)


def test_a_module_that_cannot_be_imported_is_a_solver_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(BACKENDS, "absent", ("rmrc.qp.backends.absent", "Absent"))
    with pytest.raises(SolverError, match="'absent' is not installed: pip install absent"):
        create("absent")


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


# The program itself.


def test_a_new_program_has_its_buffers_and_no_limits() -> None:
    qp = QP(3, rows=2, equalities=1)
    shapes = {"H": (3, 3), "g": (3,), "lb": (3,), "ub": (3,), "C": (2, 3), "lo": (2,), "hi": (2,)}
    for name, shape in {**shapes, "E": (1, 3), "f": (1,)}.items():
        buffer = getattr(qp, name)
        assert (buffer.shape, buffer.dtype) == (shape, np.float64)
        assert buffer.flags.c_contiguous
    assert np.isneginf([*qp.lb, *qp.lo]).all()
    assert np.isposinf([*qp.ub, *qp.hi]).all()
    assert qp.defect() is None
    assert not hasattr(qp, "__dict__")


@pytest.mark.parametrize("status", SolveStatus)
def test_every_status_has_a_sentence(status: SolveStatus) -> None:
    assert status.message.endswith(".")
    assert status.message.count(".") == 1


def test_the_answer_where_there_is_none_is_at_rest_and_not_certified() -> None:
    solution = Solution.at_rest(QP(3, rows=2, equalities=1))
    assert solution.status is SolveStatus.FAILED
    assert solution.kkt is UNCERTIFIED
    parts = (solution.v, solution.bound_multiplier, solution.row_multiplier)
    assert [part.tolist() for part in parts] == [[0.0] * 3, [0.0] * 3, [0.0] * 2]


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
