"""The solver of the native engine, an active-set method of our own (see docs/native.md)."""

from rmrc._native import QPSolver
from rmrc.qp.backends.base import Backend
from rmrc.qp.program import QP, Solution, SolveStatus

MOST_CHANGES = 10_000
"""Changes of the active set that a solve may use where the configuration says nothing."""


class Native(Backend):
    """`rmrc._native.QPSolver`, which starts from the active set of the last solve.

    It ends at the optimum to rounding, and reads the program as it is when it solves. It looks at
    the clock between any two changes of the active set.
    """

    screened = False

    def __init__(self, max_iter: int | None = None) -> None:
        super().__init__(polished=False)
        self._max_iter = MOST_CHANGES if max_iter is None else max_iter
        self._solver: QPSolver | None = None

    def _load(self, qp: QP) -> SolveStatus | None:
        if self._solver is None or self._solver.shape != (qp.g.size, qp.lo.size, qp.f.size):
            self._solver = QPSolver(qp.g.size, qp.lo.size, qp.f.size, self._max_iter)
        self._solver.forget()
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        return None

    def _run(self, qp: QP, seconds: float) -> Solution:
        assert self._solver is not None
        v, z, y, w, iterations, status = self._solver.solve(
            qp.H, qp.g, qp.lb, qp.ub, qp.C, qp.lo, qp.hi, qp.E, qp.f, seconds
        )
        return Solution(v, z, y, w, iterations, SolveStatus(status))
