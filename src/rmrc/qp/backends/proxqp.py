"""ProxQP, a proximal augmented Lagrangian method (Bambade, El-Kazdadi, Taylor, Carpentier 2022)."""

from time import perf_counter

import numpy as np
from proxsuite import proxqp  # pyright: ignore[reportMissingImports]

from rmrc.qp.backends.base import Backend
from rmrc.qp.backends.pace import Pace
from rmrc.qp.program import QP, Solution, SolveStatus

INFEASIBILITY = 1e-10
"""At ProxQP's 1e-4 a feasible program with close limits passes for an infeasible one."""
INNER = 1500
"""ProxQP's own limit on the inner iterations of one outer iteration."""
STATUS = {
    proxqp.PROXQP_SOLVED: SolveStatus.SOLVED,
    proxqp.PROXQP_MAX_ITER_REACHED: SolveStatus.MAX_ITER,
    proxqp.PROXQP_PRIMAL_INFEASIBLE: SolveStatus.INFEASIBLE,
}
"""ProxQP's statuses; any other is a failure."""


class ProxQP(Backend):
    """ProxQP's persistent dense solver with box constraints, polished.

    `max_iter` counts its outer iterations. Rows that contradict the box mostly end as MAX_ITER.
    It does not look at the clock: what it may iterate follows from the pace of earlier solves.
    """

    def __init__(self, max_iter: int | None = None, tolerance: float | None = None) -> None:
        super().__init__(polished=True)
        self._max_iter = 100 if max_iter is None else max_iter
        self._tolerance = 1e-6 if tolerance is None else tolerance
        self._outer, self._inner = Pace(), Pace()

    def _load(self, qp: QP) -> SolveStatus | None:
        solver = proxqp.dense.QP(qp.g.size, qp.f.size, qp.lo.size, box_constraints=True)
        settings = solver.settings
        settings.eps_abs, settings.eps_rel = self._tolerance, 0.0
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = self._tolerance, 0.0
        settings.eps_primal_inf = settings.eps_dual_inf = INFEASIBILITY
        settings.initial_guess = proxqp.COLD_START_WITH_PREVIOUS_RESULT
        solver.init(qp.H, qp.g, qp.E, qp.f, qp.C, qp.lo, qp.hi, qp.lb, qp.ub)
        self._solver = solver
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        self._solver.update(qp.H, qp.g, qp.E, qp.f, qp.C, qp.lo, qp.hi, qp.lb, qp.ub)
        return None

    def _run(self, qp: QP, seconds: float) -> Solution:
        outer, inner = self._outer.within(seconds), self._inner.within(seconds)
        if outer < 1.0:
            return Solution.at_rest(qp, SolveStatus.TIME_LIMIT)
        settings, limit = self._solver.settings, int(min(outer, self._max_iter))
        settings.max_iter, settings.max_iter_in = limit, int(min(inner, INNER))
        begun = perf_counter()
        self._solver.solve()
        elapsed, results, rows = perf_counter() - begun, self._solver.results, qp.lo.size
        iterations = results.info.iter_ext
        self._outer.measure(elapsed, iterations)
        self._inner.measure(elapsed, results.info.iter)
        status = STATUS.get(results.info.status, SolveStatus.FAILED)
        if status is SolveStatus.MAX_ITER and limit < self._max_iter:
            status = SolveStatus.TIME_LIMIT
        multiplier = np.array(results.z)  # a copy: ProxQP hands out its own memory
        return Solution(
            np.array(results.x),
            multiplier[rows:],
            multiplier[:rows],
            np.array(results.y),
            iterations,
            status,
        )
