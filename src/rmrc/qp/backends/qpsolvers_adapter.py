"""Any other solver, through qpsolvers: without a workspace, cold at every solve."""

from math import inf
from time import perf_counter
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
import qpsolvers
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from rmrc.config.solvers import SETTINGS, Settings
from rmrc.qp.backends.base import Backend
from rmrc.qp.backends.pace import Pace
from rmrc.qp.program import QP, Array, Solution, SolveStatus

LEAST_TIME = 1e-9
"""Time limit of a solve whose time is over before it is begun, s."""


class QpsolversAdapter(Backend):
    """A solver that qpsolvers offers, called afresh for each program, and polished.

    qpsolvers does not tell the iterations nor why there is no solution: `iterations` is 0, and
    what is not solved is FAILED, or TIME_LIMIT if its time is over. A solver without a time limit
    is not begun where its earlier solves took longer than the time left.
    """

    def __init__(
        self, name: str, max_iter: int | None = None, tolerance: float | None = None
    ) -> None:
        super().__init__(polished=True)
        self._name = name
        self._sparse = name not in qpsolvers.dense_solvers
        settings = SETTINGS.get(name, Settings())
        self._options: dict[str, Any] = {}
        if max_iter is not None:
            self._options[settings.iterations] = max_iter
        if tolerance is not None:
            self._options.update(dict.fromkeys(settings.tolerances, tolerance))
        self._time_limit, self._pace = settings.seconds, Pace()

    def _load(self, qp: QP) -> SolveStatus | None:
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        return None

    def _run(self, qp: QP, seconds: float) -> Solution:
        begun = perf_counter()
        if not self._time_limit and self._pace.within(seconds) < 1.0:
            return Solution.at_rest(qp, SolveStatus.TIME_LIMIT)
        solution = self._call(qp, begun + seconds)
        now = perf_counter()
        self._pace.measure(now - begun, 1)
        if solution.status is SolveStatus.FAILED and now >= begun + seconds:
            solution.status = SolveStatus.TIME_LIMIT
        return solution

    def _call(self, qp: QP, end: float) -> Solution:
        """Return what qpsolvers makes of `qp`: SOLVED or FAILED."""
        high, low = np.isfinite(qp.hi), np.isfinite(qp.lo)
        rows = np.vstack([qp.C[high], -qp.C[low]])
        limits = np.concatenate([qp.hi[high], -qp.lo[low]])
        matrix = csc_matrix if self._sparse else np.asarray
        inequalities = (matrix(rows), limits) if limits.size else (None, None)
        equalities = (matrix(qp.E), qp.f) if qp.f.size else (None, None)
        program = qpsolvers.Problem(
            matrix(qp.H), qp.g, *inequalities, *equalities, lb=qp.lb, ub=qp.ub
        )
        with catch_warnings():
            simplefilter("ignore")  # the status says what they say
            options = self._options
            if self._time_limit and end < inf:
                # 0 is no limit to some solvers, and less than nothing an error.
                left = max(end - perf_counter(), LEAST_TIME)
                options = {**options, self._time_limit: left}
            try:
                found = qpsolvers.solve_problem(program, self._name, **options)
            except Exception:  # every solver raises classes of its own
                return Solution.at_rest(qp)
        solution = Solution.at_rest(qp)
        if not found.found or found.x is None:
            return solution
        solution.v[:], solution.status = found.x, SolveStatus.SOLVED
        _set(solution.bound_multiplier, found.z_box)
        _set(solution.equality_multiplier, found.y)
        sides = np.zeros(limits.size)
        _set(sides, found.z)
        count = np.count_nonzero(high)
        solution.row_multiplier[high] += sides[:count]
        solution.row_multiplier[low] -= sides[count:]
        return solution


def _set(multiplier: Array, found: ArrayLike | None) -> None:
    """Copy a multiplier that the solver may have left out."""
    if found is not None and np.size(found):
        multiplier[:] = found
