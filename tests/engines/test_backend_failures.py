"""What a backend says where there is no answer, and that it leaves no trace."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import qpsolvers
from backend_programs import BUILDERS, KKT_TOLERANCE, SAME_VELOCITY, programs
from programs import copy_into, copy_of, random_qp, solved

from rmrc.errors import SolverError
from rmrc.qp.backends import BACKENDS, Backend, create
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Solution, SolveStatus


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


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
