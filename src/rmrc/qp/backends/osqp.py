"""OSQP, an operator-splitting method (Stellato, Banjac, Goulart, Bemporad and Boyd 2020)."""

from time import perf_counter

import numpy as np
import osqp
from scipy.sparse import csc_matrix

from rmrc.qp.backends.base import Backend
from rmrc.qp.program import QP, Array, Solution, SolveStatus

STATUS = {
    "solved": SolveStatus.SOLVED,
    "solved inaccurate": SolveStatus.MAX_ITER,
    "maximum iterations reached": SolveStatus.MAX_ITER,
    "run time limit reached": SolveStatus.TIME_LIMIT,
    "primal infeasible": SolveStatus.INFEASIBLE,
    "primal infeasible inaccurate": SolveStatus.INFEASIBLE,
}
"""OSQP's statuses; any other is a failure."""
ROUGH = " inaccurate"
"""How OSQP ends the name of a status that holds to ten times the tolerances, at its last look."""
UNLIMITED = 1e10
"""OSQP's time limit where there is none, s."""


class OSQP(Backend):
    """OSQP's persistent solver, polished.

    It has rows only: A is [I; C; E], with the bounds as limits of the identity. The patterns of P
    (upper triangle) and A are full, so that `_refresh` may change any value. It looks at the clock
    at every iteration.
    """

    def __init__(self, max_iter: int | None = None, tolerance: float | None = None) -> None:
        super().__init__(polished=True)
        self._settings = {
            "max_iter": 10_000 if max_iter is None else max_iter,
            "eps_abs": 1e-6 if tolerance is None else tolerance,
            "eps_rel": 0.0,
            # At OSQP's 1e-4 an ill-conditioned program without limits passes for unbounded.
            "eps_dual_inf": 1e-12,
            "verbose": False,
        }

    def _load(self, qp: QP) -> SolveStatus | None:
        n, m = qp.g.size, qp.lo.size + qp.f.size
        # Column j of the upper triangle holds rows 0 … j; column j of A its 1 and then all of C, E.
        self._column, self._row = np.tril_indices(n)
        starts = np.concatenate([[0], np.cumsum(np.arange(1, n + 1))])
        hessian = csc_matrix((self._hessian(qp), self._row, starts), (n, n))
        self._entries = np.ones((n, 1 + m))
        places = np.column_stack([np.arange(n), np.tile(np.arange(n, n + m), (n, 1))])
        starts = np.arange(n + 1) * (1 + m)
        rows = csc_matrix((self._matrix(qp), places.ravel(), starts), (n + m, n))
        # Without a name each new solver looks through the packages for others.
        self._solver = osqp.OSQP(algebra="builtin")
        self._time_limit, self._reading = UNLIMITED, 0.0
        try:
            self._solver.setup(hessian, qp.g, rows, *self._limits(qp), **self._settings)
        except osqp.OSQPException:
            return SolveStatus.FAILED
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        lower, upper = self._limits(qp)
        hessian, matrix = self._hessian(qp), self._matrix(qp)
        begun = perf_counter()
        self._solver.update(q=qp.g, l=lower, u=upper, Px=hessian, Ax=matrix)
        self._reading = perf_counter() - begun
        return None

    def _hessian(self, qp: QP) -> Array:
        """Return the values of P."""
        return qp.H[self._row, self._column]

    def _matrix(self, qp: QP) -> Array:
        """Return the values of A."""
        ends = 1 + qp.lo.size
        self._entries[:, 1:ends], self._entries[:, ends:] = qp.C.T, qp.E.T
        return self._entries.ravel()

    def _limits(self, qp: QP) -> tuple[Array, Array]:
        return np.concatenate([qp.lb, qp.lo, qp.f]), np.concatenate([qp.ub, qp.hi, qp.f])

    def _run(self, qp: QP, seconds: float) -> Solution:
        # OSQP counts the time of an update as part of the solve that follows. So it does with that
        # of the setup, where it does not say how long it took: a first solve ends early by that.
        time_limit = min(seconds + self._reading, UNLIMITED)
        if time_limit != self._time_limit:
            self._solver.update_settings(time_limit=time_limit)
            self._time_limit = time_limit
        result = self._solver.solve(raise_error=False)
        self._reading = 0.0
        outcome, iterations = result.info.status, result.info.iter
        status = STATUS.get(outcome, SolveStatus.FAILED)
        if outcome.endswith(ROUGH) and iterations < self._settings["max_iter"]:
            if status is not SolveStatus.MAX_ITER:  # infeasible as it seems, and without a point
                return Solution.at_rest(qp, SolveStatus.TIME_LIMIT, iterations)
            status = SolveStatus.TIME_LIMIT
        multiplier = result.y
        n, m = qp.g.size, qp.g.size + qp.lo.size
        return Solution(
            result.x, multiplier[:n], multiplier[n:m], multiplier[m:], iterations, status
        )
