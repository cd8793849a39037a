"""Our own residuals of the optimality conditions: no backend is taken at its word."""

from math import isfinite, isinf, sqrt

import numpy as np

from rmrc.qp.program import KKT, QP, UNCERTIFIED, Array, Solution


class _Interval:
    """lower ≤ x ≤ upper, with a buffer allocated once."""

    __slots__ = ("_inside", "_lower", "_upper")

    def __init__(self, lower: Array, upper: Array) -> None:
        self._lower, self._upper = lower, upper
        self._inside = np.empty(lower.size)

    def clip(self, x: Array) -> float:
        """Move x into the interval, in place, and return the squared distance it was moved."""
        inside = self._inside
        np.maximum(x, self._lower, out=inside)
        np.minimum(inside, self._upper, out=inside)
        if inside.tobytes() == x.tobytes():  # the cheapest comparison of two short arrays
            return 0.0
        np.subtract(x, inside, out=x)
        moved = x.dot(x)
        x[:] = inside
        return moved

    def slackness(self, x: Array, multiplier: Array) -> tuple[float, float]:
        """Return Σ m⁺(upper − x) + m⁻(x − lower), and Σ m² over the limits that are infinite.

        x is inside the interval; m⁺ = max(m, 0), m⁻ = max(−m, 0).
        """
        lower, upper = self._lower, self._upper
        slackness = infinite = 0.0
        # Few multipliers are not 0: visiting those takes half the time of six array operations.
        for k in multiplier.nonzero()[0].tolist():
            m, value = multiplier.item(k), x.item(k)
            distance = upper.item(k) - value if m > 0.0 else value - lower.item(k)
            if isinf(distance):
                infinite += m * m
            else:
                slackness += abs(m) * distance
        return slackness, infinite


class Certificate:
    """The residuals of solutions of one `QP`, whose buffers are read when `certify` is called.

    They are absolute. `primal` and `dual` are 2-norms and `complementarity` is a sum of terms ≥ 0:
    each bounds its ∞-norm from above.
    """

    __slots__ = ("_activity", "_bounds", "_misfit", "_qp", "_residual", "_rows")

    def __init__(self, qp: QP) -> None:
        self._qp = qp
        self._bounds, self._rows = _Interval(qp.lb, qp.ub), _Interval(qp.lo, qp.hi)
        self._residual = np.empty(qp.g.size)
        self._activity, self._misfit = np.empty(qp.lo.size), np.empty(qp.f.size)

    @np.errstate(all="ignore")  # what is not finite shows in the residuals
    def certify(self, solution: Solution) -> float:
        """Clip `solution.v` into the box, in place, set `solution.kkt` and return its largest.

        A backend's primal tolerance must not leak past a limit; how far clipping moved v is part
        of the primal residual. All residuals are infinite where any number is not finite.
        """
        qp, v, z = self._qp, solution.v, solution.bound_multiplier
        residual = self._residual
        primal = self._bounds.clip(v)
        qp.H.dot(v, residual)
        residual += qp.g
        complementarity = stray = 0.0
        if z.dot(z):
            residual += z
            complementarity, stray = self._bounds.slackness(v, z)
        y, w = solution.row_multiplier, solution.equality_multiplier
        if y.size:
            activity = qp.C.dot(v, self._activity)
            primal += self._rows.clip(activity)
            residual += y.dot(qp.C)
            slackness, infinite = self._rows.slackness(activity, y)
            complementarity += slackness
            stray += infinite
        if w.size:
            misfit = qp.E.dot(v, self._misfit)
            misfit -= qp.f
            primal += misfit.dot(misfit)
            residual += w.dot(qp.E)
        dual = residual.dot(residual) + stray
        if isfinite(primal + dual + complementarity):
            solution.kkt = KKT(sqrt(primal), sqrt(dual), complementarity)
        else:
            solution.kkt = UNCERTIFIED
        return max(solution.kkt)
