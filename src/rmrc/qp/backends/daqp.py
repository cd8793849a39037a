"""DAQP, a dual active-set method (Arnström, Bemporad and Axehill 2022): the default backend."""

from math import inf, isnan

import daqp
import numpy as np

from rmrc.qp.backends.base import Backend
from rmrc.qp.program import QP, Solution, SolveStatus

INFINITY = 1e30
"""DAQP's infinity: IEEE's, at a bound that was active before, makes a warm start go wrong."""
STATUS = {
    1: SolveStatus.SOLVED,
    4: SolveStatus.SOLVED,  # but for rounding: the certificate tells by how much
    -1: SolveStatus.INFEASIBLE,
    -4: SolveStatus.MAX_ITER,
    -6: SolveStatus.INFEASIBLE,  # equalities that contradict each other
    -7: SolveStatus.TIME_LIMIT,
}
"""DAQP's exit flags; any other is a failure."""


SHORT, NOTHING = 1e-3, 1e-12
"""DAQP ignores rows shorter than 3e-6: those in between are made units, the shortest are none."""


class DAQP(Backend):
    """DAQP's persistent `Model`, which starts from the active set of the last solve.

    The bounds are the first n of its limits, the rows C and E the rest. Its tolerance is the
    distance by which it lets a limit be passed: 1e-6 of its own accord, 1e-12 here. It looks at
    the clock every 32 iterations.
    """

    screened = False

    def __init__(self, max_iter: int | None = None, tolerance: float | None = None) -> None:
        super().__init__(polished=False)
        self._short = False  # whether a row was made a unit
        self._settings = {
            "primal_tol": 1e-12 if tolerance is None else tolerance,
            # Of the proximal iterations that a singular H takes; 1e-6 of its own is too loose.
            "eta_prox": 1e-12 if tolerance is None else tolerance,
            # DAQP stops in front of the iteration of this number.
            "iter_limit": (10_000 if max_iter is None else max_iter) + 1,
        }

    def _load(self, qp: QP) -> SolveStatus | None:
        n, rows = qp.g.size, qp.lo.size
        size = n + rows + qp.f.size
        self._lower, self._upper, cap = np.full((3, size), INFINITY)
        self._scale = np.ones(size)
        self._limits = [
            (
                low,
                high,
                cap[part],
                -cap[part],
                self._lower[part],
                self._upper[part],
                self._scale[part],
            )
            for low, high, part in (
                (qp.lb, qp.ub, slice(n)),
                (qp.lo, qp.hi, slice(n, n + rows)),
                (qp.f, qp.f, slice(n + rows, size)),
            )
            if low.size
        ]
        self._rows = np.empty((size - n, n))
        self._copy(qp)
        self._model = daqp.Model()
        self._model.settings = self._settings
        self._seconds = inf
        flag, _ = self._model.setup(qp.H, qp.g, self._rows, self._upper, self._lower)
        return None if flag > 0 else STATUS.get(flag, SolveStatus.FAILED)

    def _refresh(self, qp: QP) -> SolveStatus | None:
        self._copy(qp)
        if self._rows.size:
            if defect := qp.defect():
                return defect
        elif isnan(self._lower.dot(self._upper)):  # DAQP would call such a program solved
            return SolveStatus.FAILED
        # Without `sense` DAQP keeps its active set; a matrix of no rows it would refuse.
        rows = self._rows if self._rows.size else None
        flag = self._model.update(qp.H, qp.g, rows, self._upper, self._lower)
        return None if flag == 0 else STATUS.get(flag, SolveStatus.FAILED)

    def _copy(self, qp: QP) -> None:
        """Stack the limits, and the rows, into the arrays that the model points to."""
        if self._rows.size:
            rows = qp.lo.size
            self._rows[:rows], self._rows[rows:] = qp.C, qp.E
            length = np.sqrt(np.einsum("ij,ij->i", self._rows, self._rows))
            short = (length < SHORT) & (length > NOTHING)
            self._short = bool(short.any())
            if self._short:
                scale = self._scale[qp.g.size :]
                scale[:] = 1.0
                scale[short] = 1.0 / length[short]
                self._rows *= scale[:, None]
        for low, high, cap, floor, lower, upper, scale in self._limits:
            np.maximum(scale * low if self._short else low, floor, out=lower)
            np.minimum(scale * high if self._short else high, cap, out=upper)

    def _run(self, qp: QP, seconds: float) -> Solution:
        if seconds != self._seconds:
            self._model.settings = {"time_limit": seconds}
            self._seconds = seconds
        v, _, flag, info = self._model.solve()
        status = STATUS.get(flag, SolveStatus.FAILED)
        iterations = min(info["iterations"], self._settings["iter_limit"] - 1)
        if status is not SolveStatus.SOLVED:
            # A dual method has no velocity to offer before its last iteration.
            return Solution.at_rest(qp, status, iterations)
        n, m, multiplier = qp.g.size, qp.g.size + qp.lo.size, info["lam"]
        if self._short:
            multiplier = self._scale * multiplier
        return Solution(v, multiplier[:n], multiplier[n:m], multiplier[m:], iterations, status)
