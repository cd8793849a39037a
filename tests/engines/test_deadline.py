"""The time that a solve may use: kept by every backend, and what is answered when it is over."""

from math import inf
from time import thread_time

import numpy as np
import pytest
from clocks import Clock
from programs import copy_of, moving_program, random_qp, solved

from rmrc.qp.backends import BACKENDS, Backend, create
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
