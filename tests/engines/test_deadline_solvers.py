"""How each solver is kept to its time: its pace, its own limit, what it says when cut off."""

from collections.abc import Callable
from math import inf

import daqp
import numpy as np
import osqp
import pytest
import qpsolvers
from clocks import Clock
from programs import copy_of, random_qp, solved

from rmrc.qp.backends import create
from rmrc.qp.backends.osqp import OSQP, UNLIMITED
from rmrc.qp.backends.pace import FADING, Pace
from rmrc.qp.program import SolveStatus

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
