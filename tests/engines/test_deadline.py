"""The time that a solve may use: kept by every backend, and what is answered when it is over."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from time import thread_time

import daqp
import numpy as np
import osqp
import pytest
import qpsolvers
from programs import copy_of, moving_program, random_qp, solved

import rmrc.qp.backends.base as backends
from rmrc.qp.backends import BACKENDS, Backend, create, qpsolvers_adapter
from rmrc.qp.backends import osqp as osqp_backend
from rmrc.qp.backends import proxqp as proxqp_backend
from rmrc.qp.backends.osqp import OSQP, UNLIMITED
from rmrc.qp.backends.pace import FADING, Pace
from rmrc.qp.backends.qpsolvers_adapter import QpsolversAdapter
from rmrc.qp.certificate import Certificate
from rmrc.qp.polish import Polish
from rmrc.qp.program import QP, Solution, SolveStatus

KKT_TOLERANCE = 1e-8
"""What SOLVED stands for, under a deadline as without one; relative to the largest of 1 and |g|."""
SAME_VELOCITY = 1e-7
"""Two solutions of one program: KKT residuals of 1e-8 and |g| up to 10, with λ_min(H) ≥ 1."""
BUDGETS = (10e-6, 50e-6, 200e-6)
CUT_OFF = 0.5
"""What a solve may run beyond its budget, as a share of what it takes without one. Measured: 0.1,
the 32 iterations in which DAQP does not look at the clock, and 0.2 with qpsolvers' preparations."""

BUILDERS: dict[str, Callable[[], Backend]] = {
    **{name: lambda name=name: create(name) for name in BACKENDS},
    "adapter": lambda: QpsolversAdapter("daqp"),
}


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


@dataclass
class Clock:
    """A clock that stands still between two `tick`s apart from `step` at each look, s."""

    now: float = 0.0
    step: float = 0.0

    def __call__(self) -> float:
        self.now += self.step
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (backends, osqp_backend, proxqp_backend, qpsolvers_adapter):
        monkeypatch.setattr(module, "perf_counter", clock)
    return clock


def moving(n: int, rows: int, steps: int) -> list[QP]:
    return [copy_of(qp) for qp in moving_program(np.random.default_rng(0), n, rows, steps)]


def certified(qp: QP, solution: Solution) -> bool:
    largest = max(1.0, float(np.abs(qp.g).max()))
    return Certificate(qp).certify(solution) <= KKT_TOLERANCE * largest


# Nothing is begun without time.


@pytest.mark.parametrize("seconds", [0.0, -1.0, -inf])
def test_a_solve_without_time_is_not_begun(backend: Backend, seconds: float) -> None:
    qp = random_qp(np.random.default_rng(1), 7, rows=3)
    for begin in (backend.setup, backend.update):
        backend.allow(seconds)
        begin(qp)
        solution = backend.solve()
        assert solution.status is SolveStatus.TIME_LIMIT
        assert solution.iterations == 0
        assert not solution.v.any()
        backend.allow(None)
        backend.update(qp)
        solution = backend.solve()
        assert solution.status is SolveStatus.SOLVED
        assert certified(qp, solution)


def test_nothing_is_read_without_time(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    qp = random_qp(np.random.default_rng(1), 7, rows=3)
    solved(backend, qp)
    for name in ("_load", "_refresh", "_run"):
        monkeypatch.setattr(backend, name, None)
    backend.allow(0.0)
    for begin in (backend.update, backend.setup):
        begin(qp)
        assert backend.solve().status is SolveStatus.TIME_LIMIT


def test_a_program_that_was_not_read_is_not_solved_later(backend: Backend) -> None:
    qp = random_qp(np.random.default_rng(2), 7, rows=3)
    before = solved(backend, qp)
    qp.g[:] = -qp.g
    backend.allow(0.0)
    backend.update(qp)
    backend.allow(None)
    assert backend.solve().status is SolveStatus.TIME_LIMIT
    backend.update(qp)
    after = backend.solve()
    assert after.status is SolveStatus.SOLVED
    assert certified(qp, after)
    assert not np.array_equal(after.v, before.v)


@pytest.mark.parametrize("name", BACKENDS)
def test_one_end_holds_for_all_solves_until_the_next_call(name: str, clock: Clock) -> None:
    qp, backend = random_qp(np.random.default_rng(3), 7), create(name)
    solved(backend, qp)  # and so it has a pace
    backend.allow(1.0)
    for now, status in ((0.0, "solved"), (0.9, "solved"), (1.0, "time_limit"), (5.0, "time_limit")):
        clock.now = now
        backend.update(qp)
        assert backend.solve().status.value == status
    backend.allow(1.0)
    backend.update(qp)
    assert backend.solve().status is SolveStatus.SOLVED


# Budgets that cut a solve off.


@pytest.mark.parametrize("budget", BUDGETS)
def test_the_answer_to_a_budget_is_a_solution_or_a_finite_point(
    backend: Backend, budget: float
) -> None:
    for qp in moving(43, 30, steps=40):
        backend.allow(budget)
        backend.update(qp)
        solution = backend.solve()
        # OSQP, cut off again and again, at times finds its own numbers broken and says FAILED.
        assert solution.status in (SolveStatus.SOLVED, SolveStatus.TIME_LIMIT, SolveStatus.FAILED)
        assert np.isfinite(solution.v).all()
        assert solution.status is not SolveStatus.SOLVED or certified(qp, solution)


@pytest.mark.parametrize("budget", BUDGETS)
def test_a_long_solve_is_cut_off(backend: Backend, budget: float) -> None:
    qp = random_qp(np.random.default_rng(5), 60, "vertex", rows=400)
    qp.H[:] += np.eye(60)

    def fastest(seconds: float | None, status: SolveStatus) -> float:
        took = []
        for _ in range(5):  # the fastest is not that of a busy machine
            backend.allow(None)
            backend.setup(qp)
            backend.allow(seconds)
            begun = thread_time()
            solution = backend.solve()
            took.append(thread_time() - begun)
            assert solution.status is status
        return min(took)

    unlimited = fastest(None, SolveStatus.SOLVED)
    assert fastest(budget, SolveStatus.TIME_LIMIT) - budget < CUT_OFF * unlimited


@pytest.mark.parametrize("name", BACKENDS)
def test_what_was_cut_off_is_taken_up_again(name: str) -> None:
    # Cold starts would never end: the budget is less than the first solve takes.
    qp = random_qp(np.random.default_rng(6), 43, rows=200)
    qp.H[:] += np.eye(43)
    backend, spent = create(name), []
    exact = solved(backend, qp)
    for _ in range(3):
        backend.setup(qp)
        begun = thread_time()
        backend.solve()
        spent.append(thread_time() - begun)
    backend = create(name)
    backend.setup(qp)
    solutions = []
    for _ in range(300):
        backend.update(qp)
        backend.allow(0.4 * min(spent))
        solutions.append(backend.solve())
        if solutions[-1].status is SolveStatus.SOLVED:
            break
    assert solutions[0].status is SolveStatus.TIME_LIMIT
    assert solutions[-1].status is SolveStatus.SOLVED
    assert certified(qp, solutions[-1])
    np.testing.assert_allclose(solutions[-1].v, exact.v, rtol=0.0, atol=SAME_VELOCITY)


def test_budgets_leave_no_trace(backend: Backend) -> None:
    rng = np.random.default_rng(7)
    cut = 0
    for k, qp in enumerate(moving_program(np.random.default_rng(8), 20, 30, steps=100)):
        free = k % 4 == 3
        backend.allow(None if free else float(rng.choice(BUDGETS)))
        backend.update(qp) if k else backend.setup(qp)
        solution = backend.solve()
        cut += solution.status is SolveStatus.TIME_LIMIT
        if free:
            assert solution.status is SolveStatus.SOLVED
            assert certified(qp, solution)
            fresh = solved(create("daqp"), qp)
            np.testing.assert_allclose(solution.v, fresh.v, rtol=0.0, atol=SAME_VELOCITY)
    assert cut > 5


def test_all_the_time_there_is_changes_nothing(backend: Backend) -> None:
    for qp in moving(7, 3, steps=10):
        free = solved(backend, qp)
        backend.allow(1e3)
        limited = solved(backend, qp)
        backend.allow(None)
        assert limited.status is free.status
        assert limited.iterations == free.iterations
        np.testing.assert_array_equal(limited.v, free.v)


# The polish.


class Late(Backend):
    """A backend that takes its time, by the clock, over a solution that is near the optimum."""

    def __init__(self, clock: Clock, status: SolveStatus) -> None:
        super().__init__(polished=True)
        self.clock, self.status, self.took = clock, status, 1.0

    def _load(self, qp: QP) -> None:
        pass

    def _refresh(self, qp: QP) -> None:
        pass

    def _run(self, qp: QP, seconds: float) -> Solution:
        self.clock.now += self.took
        solution = Solution.at_rest(qp, self.status, 3)
        solution.v[:] = 0.1
        return solution


def unlimited_program() -> QP:
    """Return a program that a polish solves from anywhere."""
    qp = QP(7)
    qp.H[:], qp.g[:] = np.eye(7), 1.0
    return qp


@pytest.mark.parametrize(
    "status", [SolveStatus.SOLVED, SolveStatus.MAX_ITER, SolveStatus.TIME_LIMIT]
)
def test_there_is_no_polish_when_the_time_is_used_up(clock: Clock, status: SolveStatus) -> None:
    qp, backend = unlimited_program(), Late(clock, status)
    assert solved(backend, qp).status is SolveStatus.SOLVED  # polished
    backend.allow(1.0)
    backend.update(qp)
    solution = backend.solve()
    np.testing.assert_array_equal(solution.v, 0.1)
    # Not to the residuals that SOLVED stands for.
    assert solution.status is (SolveStatus.TIME_LIMIT if status is SolveStatus.SOLVED else status)


def test_there_is_no_polish_where_the_last_took_longer_than_the_time_left(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Polish.improve

    def improve(polish: Polish, solution: Solution) -> Solution:
        clock.now += 10.0
        return real(polish, solution)

    monkeypatch.setattr(Polish, "improve", improve)
    qp, backend = unlimited_program(), Late(clock, SolveStatus.MAX_ITER)
    solved(backend, qp)
    for seconds, status in ((6.0, SolveStatus.MAX_ITER), (12.0, SolveStatus.SOLVED)):
        backend.allow(seconds)
        backend.update(qp)
        assert backend.solve().status is status


# The pace of solvers that do not look at the clock.


def test_a_pace_is_that_of_the_slowest_lately() -> None:
    pace = Pace()
    assert pace.within(1e-6) == 1.0
    assert pace.within(inf) == inf
    pace.measure(6.0, 3)
    pace.measure(1.0, 1)
    assert pace.within(20.0) == pytest.approx(10.0 / FADING)
    pace.measure(8.0, 2)
    assert pace.within(20.0) == pytest.approx(5.0 / FADING)
    assert pace.within(inf) == inf
    for _ in range(100):
        pace.within(1.0)
    pace.measure(1.0, 1)
    assert pace.within(20.0) == pytest.approx(20.0 / FADING)


def test_proxqp_iterates_as_often_as_its_pace_lets_it(clock: Clock) -> None:
    qp, backend = random_qp(np.random.default_rng(10), 43, "vertex", rows=30), create("proxqp")
    needed = solved(backend, copy_of(qp)).iterations
    assert needed > 5
    backend, clock.step = create("proxqp"), 1.0  # each solve takes a second
    for seconds, iterations in ((100.0, 1), (3.2, 3), (1.0, 1)):  # its pace is unknown at first
        backend.setup(qp)
        solution = backend._run(qp, seconds)
        assert solution.iterations == iterations
        assert solution.status is SolveStatus.TIME_LIMIT
    backend.setup(qp)
    assert backend._run(qp, inf).iterations == needed


def test_proxqp_tries_again_what_was_too_long(clock: Clock) -> None:
    qp, backend = random_qp(np.random.default_rng(10), 7, rows=3), create("proxqp")
    clock.step = 10.0
    solved(backend, qp)
    clock.step = 0.0
    begun = []
    for _ in range(60):
        backend.allow(0.5)
        backend.update(qp)
        begun.append(backend.solve().iterations > 0)
    assert not begun[0]
    assert begun[-1]


# Solvers of qpsolvers.


def borrow(
    monkeypatch: pytest.MonkeyPatch, name: str, solve: Callable[..., qpsolvers.Solution]
) -> None:
    """Give qpsolvers a solver of that name."""
    monkeypatch.setitem(qpsolvers.solvers.solve_function, name, solve)
    monkeypatch.setattr(qpsolvers, "available_solvers", [*qpsolvers.available_solvers, name])
    monkeypatch.setattr(qpsolvers, "dense_solvers", [*qpsolvers.dense_solvers, name])


@pytest.mark.parametrize(
    ("name", "option"), [("clarabel", "time_limit"), ("scs", "time_limit_secs")]
)
def test_a_solver_of_qpsolvers_is_handed_its_own_time_limit(
    monkeypatch: pytest.MonkeyPatch, clock: Clock, name: str, option: str
) -> None:
    calls = []

    def solve(problem: qpsolvers.Problem, **options: object) -> qpsolvers.Solution:
        calls.append(options.get(option))
        return qpsolvers.solvers.solve_function["daqp"](problem)

    borrow(monkeypatch, name, solve)
    qp, backend = random_qp(np.random.default_rng(11), 7, rows=3), create(name)
    for seconds in (2.0, None):
        backend.allow(seconds)
        assert solved(backend, qp).status is SolveStatus.SOLVED
    assert calls == [2.0, None]


def test_a_solver_of_qpsolvers_without_a_time_limit_is_not_begun_when_it_took_too_long(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    def solve(problem: qpsolvers.Problem, **options: object) -> qpsolvers.Solution:
        clock.now += 2.0
        return qpsolvers.solvers.solve_function["daqp"](problem)

    borrow(monkeypatch, "quadprog", solve)
    qp, backend = random_qp(np.random.default_rng(11), 7, rows=3), create("quadprog")
    assert solved(backend, qp).status is SolveStatus.SOLVED
    before = clock.now
    backend.allow(1.0)
    assert solved(backend, qp).status is SolveStatus.TIME_LIMIT
    assert clock.now == before
    backend.allow(3.0)
    assert solved(backend, qp).status is SolveStatus.SOLVED


@pytest.mark.parametrize(
    ("seconds", "status"), [(1.0, SolveStatus.TIME_LIMIT), (3.0, SolveStatus.FAILED)]
)
def test_what_qpsolvers_has_not_solved_when_the_time_is_over_is_a_time_limit(
    monkeypatch: pytest.MonkeyPatch, clock: Clock, seconds: float, status: SolveStatus
) -> None:
    def solve(problem: qpsolvers.Problem, **options: object) -> qpsolvers.Solution:
        clock.now += 2.0
        return qpsolvers.Solution(problem)

    borrow(monkeypatch, "clarabel", solve)
    backend = create("clarabel")
    backend.allow(seconds)
    assert solved(backend, random_qp(np.random.default_rng(11), 7)).status is status


# What the solvers do by themselves, and what we make of it.


def test_daqp_looks_at_the_clock_every_32_iterations() -> None:
    qp, model = random_qp(np.random.default_rng(5), 60, "vertex", rows=800), daqp.Model()
    upper, lower = np.append(qp.ub, qp.hi), np.append(qp.lb, qp.lo)
    model.settings = {"time_limit": 1e-9}
    model.setup(qp.H, qp.g, qp.C, np.minimum(upper, 1e30), np.maximum(lower, -1e30))
    _, _, flag, info = model.solve()
    assert flag == -7
    assert info["iterations"] == 32


def test_osqp_counts_an_update_as_time_of_the_solve() -> None:
    qp, backend = random_qp(np.random.default_rng(12), 43, rows=3), OSQP()
    solved(backend, qp)
    backend.update(qp)
    info = backend._solver.solve(raise_error=False).info
    assert info.update_time > 0.0
    assert info.run_time == info.update_time + info.solve_time


def test_osqp_is_given_the_time_of_its_update_back(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    given = []
    real = osqp.OSQP.update_settings

    def update_settings(solver: osqp.OSQP, **settings: float) -> None:
        given.append(settings.get("time_limit"))
        real(solver, **settings)

    qp, backend = random_qp(np.random.default_rng(12), 7, rows=3), OSQP()
    backend.setup(qp)
    monkeypatch.setattr(osqp.OSQP, "update_settings", update_settings)
    for _ in range(2):
        backend._run(qp, 5.0)
    clock.step = 1.0
    backend._refresh(qp)
    for seconds in (5.0, 5.0, inf, inf):
        backend._run(qp, seconds)
    assert given == [5.0, 6.0, 5.0, UNLIMITED]


def test_what_osqp_takes_for_infeasible_when_cut_off_is_a_time_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    qp, backend = random_qp(np.random.default_rng(12), 7, rows=3), create("osqp")
    real = osqp.OSQP.solve

    def solve(solver: osqp.OSQP, raise_error: bool) -> object:
        result = real(solver, raise_error=raise_error)
        result.info.status, result.x[:] = "primal infeasible inaccurate", 2143289344.0
        return result

    backend.setup(qp)
    monkeypatch.setattr(osqp.OSQP, "solve", solve)
    backend.allow(1.0)
    solution = backend.solve()
    assert solution.status is SolveStatus.TIME_LIMIT
    assert np.abs(solution.v).max() < 1e3
