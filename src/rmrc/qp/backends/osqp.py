"""OSQP, an operator-splitting method (Stellato, Banjac, Goulart, Bemporad and Boyd 2020)."""

import numpy as np
import osqp
from scipy.sparse import csc_matrix

from rmrc.qp.backends import Backend
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


class OSQP(Backend):
    """OSQP's persistent solver, polished.

    It has rows only: A is [I; C; E], with the bounds as limits of the identity. The patterns of P
    (upper triangle) and A are full, so that `_refresh` may change any value.
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
        self._solver = osqp.OSQP()
        try:
            self._solver.setup(hessian, qp.g, rows, *self._limits(qp), **self._settings)
        except osqp.OSQPException:
            return SolveStatus.FAILED
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        lower, upper = self._limits(qp)
        self._solver.update(q=qp.g, l=lower, u=upper, Px=self._hessian(qp), Ax=self._matrix(qp))
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

    def _run(self, qp: QP) -> Solution:
        result = self._solver.solve(raise_error=False)
        multiplier = result.y
        n, m = qp.g.size, qp.g.size + qp.lo.size
        return Solution(
            result.x,
            multiplier[:n],
            multiplier[n:m],
            multiplier[m:],
            result.info.iter,
            STATUS.get(result.info.status, SolveStatus.FAILED),
        )
