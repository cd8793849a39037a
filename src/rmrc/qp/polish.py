"""The last digits of an approximate solution, from one linear system on its active limits."""

import numpy as np

from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Array, Solution, SolveStatus

TARGET = 1e-9
"""KKT residual at which a polished solution is taken even if that before it has a smaller one.

It depends on the active limits alone, not on the way to them: ProxQP's own last digits change with
the place of its arrays in memory, a polished solution's do not.
"""
OPTIMAL = 1e-8
"""KKT residual, relative to the largest of 1 and |g|, of a solution that is SOLVED in any case."""
SHIFT = 1e-7
"""Share of 1/trace(H) that makes dependent rows solvable; refinement removes its effect."""
REFINEMENTS = 3
"""Steps of iterative refinement after the solve."""


class Polish:
    """Polishes solutions of one `QP`, for backends that approach the optimum without reaching it.

    A limit counts as active where its multiplier is at least its distance. On those the program is
    an equality-constrained one, and its optimality conditions are linear:

        H v + g + z + Kᵀu = 0,  v = limit on the active bounds,  z = 0 on the others,  K v = d,

    with the active rows and the equalities in K. The result is taken where its certificate is good
    or better than before. OSQP's own polish is not used: it writes to the standard output.
    """

    def __init__(self, qp: QP) -> None:
        self._qp = qp
        self._certificate = Certificate(qp)

    @np.errstate(all="ignore")  # what is not finite fails its certificate
    def improve(self, solution: Solution) -> Solution:
        """Return the polished solution, or this one; SOLVED if its certificate is good."""
        certify = self._certificate.certify
        enough = max(TARGET, certify(solution))
        best, candidate = solution, self._on_active_limits(solution)
        if candidate is not None and certify(candidate) <= enough:
            best = candidate
        if best.kkt.largest <= OPTIMAL * max(1.0, float(np.abs(self._qp.g).max())):
            best.status = SolveStatus.SOLVED
        return best

    def _on_active_limits(self, solution: Solution) -> Solution | None:
        """Return the optimum on the active limits; None if the system is singular."""
        qp, v, z, y = self._qp, solution.v, solution.bound_multiplier, solution.row_multiplier
        at_upper, at_lower = z >= qp.ub - v, -z >= v - qp.lb
        held = at_upper | at_lower
        free = ~held
        bound = np.where(at_upper, qp.ub, np.where(at_lower, qp.lb, 0.0))
        activity = qp.C @ v
        at_high = y >= qp.hi - activity
        active = at_high | (-y >= activity - qp.lo)
        rows = np.concatenate([qp.C[active], qp.E])
        level = np.concatenate([np.where(at_high, qp.hi, qp.lo)[active], qp.f])
        slope = (qp.g + qp.H @ bound)[free]
        unknown = _solve_saddle(qp.H[free][:, free], rows[:, free], -slope, level - rows @ bound)
        if unknown is None:
            return None
        u = unknown[slope.size :]
        bound[free] = unknown[: slope.size]
        v, y, w = bound, np.zeros(y.size), u[u.size - qp.f.size :]
        y[active] = u[: u.size - qp.f.size]
        z = np.where(held, -(qp.H @ v + qp.g + u @ rows), 0.0)
        return Solution(v, z, y, w, solution.iterations, solution.status)


def _solve_saddle(hessian: Array, rows: Array, upper: Array, lower: Array) -> Array | None:
    """Return [x; u] with hessian x + rowsᵀu = upper, rows x = lower; rows may be dependent."""
    n, size = upper.size, upper.size + lower.size
    matrix = np.zeros((size, size))
    matrix[:n, :n], matrix[:n, n:], matrix[n:, :n] = hessian, rows.T, rows
    shifted = matrix.copy()
    np.fill_diagonal(shifted[n:, n:], -SHIFT / (float(np.trace(hessian)) or 1.0))
    try:
        inverse = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:
        return None
    right = np.concatenate([upper, lower])
    solution = inverse @ right
    for _ in range(REFINEMENTS):
        solution += inverse @ (right - matrix @ solution)
    return solution
