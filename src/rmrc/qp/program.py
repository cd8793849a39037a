"""The quadratic program of a step, in buffers allocated once, and what a backend answers."""

from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SolveStatus(Enum):
    """How a solve ended; `message` says it in one sentence."""

    SOLVED = "solved"
    MAX_ITER = "max_iter"
    TIME_LIMIT = "time_limit"
    INFEASIBLE = "infeasible"
    FAILED = "failed"

    @property
    def message(self) -> str:
        """One sentence on what happened."""
        return _MESSAGES[self]


_MESSAGES = {
    SolveStatus.SOLVED: "The solution is the optimum, to the tolerance of the backend.",
    SolveStatus.MAX_ITER: "The backend used up its iterations before it reached its tolerance.",
    SolveStatus.TIME_LIMIT: "The backend used up its time before it reached its tolerance.",
    SolveStatus.INFEASIBLE: "No velocity satisfies bounds, rows and equalities at once.",
    SolveStatus.FAILED: "The program holds a number that is not finite, or the backend broke down.",
}


class KKT(NamedTuple):
    """Residuals of the optimality conditions at a `Solution`: absolute, 0 at the optimum."""

    primal: float
    """2-norm of the violation of bounds, rows and equalities, in their own units."""
    dual: float
    """‖Hv + g + z + Cᵀy + Eᵀw‖₂, with the multipliers of limits that are infinite."""
    complementarity: float
    """Σ |multiplier| · distance to its limit, in units of the objective."""

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self)


UNCERTIFIED = KKT(inf, inf, inf)
"""The residuals of a solution that nothing has certified yet, or that is not finite."""


class QP:
    """min_v ½ vᵀHv + gᵀv  s.t.  lb ≤ v ≤ ub, lo ≤ C v ≤ hi, E v = f.

    With n = `size`: H (n, n) symmetric positive definite, g, lb, ub (n,), C (rows, n), lo, hi
    (rows,), E (equalities, n), f (equalities,). A limit that is absent is ±inf. The buffers are
    written in place (`qp.H[:] = …`), never replaced: a backend keeps pointers into them. `cost` is
    a program of the same size whose cost and bounds this one has, in the same buffers.
    """

    __slots__ = ("C", "E", "H", "_limits", "_numbers", "f", "g", "hi", "lb", "lo", "ub")

    def __init__(
        self, size: int, rows: int = 0, equalities: int = 0, *, cost: "QP | None" = None
    ) -> None:
        if cost is None:
            self.H = np.zeros((size, size))
            self.g = np.zeros(size)
            self.lb = np.full(size, -inf)
            self.ub = np.full(size, inf)
        else:
            self.H, self.g, self.lb, self.ub = cost.H, cost.g, cost.lb, cost.ub
        self.C = np.zeros((rows, size))
        self.lo = np.full(rows, -inf)
        self.hi = np.full(rows, inf)
        self.E = np.zeros((equalities, size))
        self.f = np.zeros(equalities)
        # What `defect` looks at, without the buffers that are empty.
        flat = (self.H.reshape(-1), self.g, self.C.reshape(-1), self.E.reshape(-1), self.f)
        self._numbers = [buffer for buffer in flat if buffer.size]
        limits = ((self.lb, self.ub), (self.lo, self.hi))
        self._limits = [(*pair, np.empty(pair[0].size, bool)) for pair in limits if pair[0].size]

    def defect(self) -> SolveStatus | None:
        """Return why no backend need try to solve this, or None.

        FAILED: a number is not finite, or a limit is NaN. INFEASIBLE: a lower limit is above its
        upper one. Backends do not look: DAQP calls a program with a NaN limit solved.
        """
        for buffer in self._numbers:
            # One call for a whole buffer: its sum of squares is finite only if all of it is.
            if not isfinite(buffer.dot(buffer)):
                return SolveStatus.FAILED
        for lower, upper, ordered in self._limits:
            if np.count_nonzero(np.less_equal(lower, upper, out=ordered)) < lower.size:
                unknown = np.isnan(lower).any() or np.isnan(upper).any()
                return SolveStatus.FAILED if unknown else SolveStatus.INFEASIBLE
        return None


@dataclass(slots=True)
class Solution:
    """What a backend answers: v, and multipliers with Hv + g + z + Cᵀy + Eᵀw = 0.

    A multiplier is ≥ 0 at an upper limit and ≤ 0 at a lower one. The arrays belong to the
    solution: the backend never writes to them again.
    """

    v: Array
    """Joint velocity (n,), rad/s or m/s; 0 where the backend has no point to offer."""
    bound_multiplier: Array
    """z (n,), of lb ≤ v ≤ ub."""
    row_multiplier: Array
    """y (rows,), of lo ≤ C v ≤ hi."""
    equality_multiplier: Array
    """w (equalities,), of E v = f."""
    iterations: int
    """Iterations used, as the backend counts them."""
    status: SolveStatus
    kkt: KKT = UNCERTIFIED
    """Residuals, once a `Certificate` has computed them."""

    @classmethod
    def at_rest(cls, qp: QP, status: SolveStatus = SolveStatus.FAILED, iterations: int = 0) -> Self:
        """Return v = 0 without multipliers, the answer where there is none."""
        n, rows, equalities = qp.g.size, qp.lo.size, qp.f.size
        zeros = (np.zeros(n), np.zeros(n), np.zeros(rows), np.zeros(equalities))
        return cls(*zeros, iterations, status)
