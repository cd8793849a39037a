"""ProxQP, a proximal augmented Lagrangian method (Bambade, El-Kazdadi, Taylor, Carpentier 2022)."""

import numpy as np
from proxsuite import proxqp  # pyright: ignore[reportMissingImports]

from rmrc.qp.backends import Backend
from rmrc.qp.program import QP, Solution, SolveStatus

INFEASIBILITY = 1e-10
"""At ProxQP's 1e-4 a feasible program with close limits passes for an infeasible one."""
STATUS = {
    proxqp.PROXQP_SOLVED: SolveStatus.SOLVED,
    proxqp.PROXQP_MAX_ITER_REACHED: SolveStatus.MAX_ITER,
    proxqp.PROXQP_PRIMAL_INFEASIBLE: SolveStatus.INFEASIBLE,
}
"""ProxQP's statuses; any other is a failure."""


class ProxQP(Backend):
    """ProxQP's persistent dense solver with box constraints, polished.

    `max_iter` counts its outer iterations. Rows that contradict the box mostly end as MAX_ITER.
    """

    def __init__(self, max_iter: int | None = None, tolerance: float | None = None) -> None:
        super().__init__(polished=True)
        self._max_iter = 100 if max_iter is None else max_iter
        self._tolerance = 1e-6 if tolerance is None else tolerance

    def _load(self, qp: QP) -> SolveStatus | None:
        solver = proxqp.dense.QP(qp.g.size, qp.f.size, qp.lo.size, box_constraints=True)
        settings = solver.settings
        settings.max_iter = self._max_iter
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

    def _run(self, qp: QP) -> Solution:
        self._solver.solve()
        results, rows = self._solver.results, qp.lo.size
        multiplier = np.array(results.z)  # a copy: ProxQP hands out its own memory
        return Solution(
            np.array(results.x),
            multiplier[rows:],
            multiplier[:rows],
            np.array(results.y),
            results.info.iter_ext,
            STATUS.get(results.info.status, SolveStatus.FAILED),
        )
