"""Rows and equalities that cannot hold together: the least by which they have to give way."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rmrc.qp.backends import create
from rmrc.qp.backends.base import Backend
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Solution, SolveStatus

Array = NDArray[np.float64]

INCONSISTENT = 1e-6
"""Largest residual of equalities that agree with one another, rad/s or m/s."""
REST = 1e-10
"""Weight of ‖v − b‖² beside that of the violations."""
ROOM = 1e-9
"""What is added to the least violation, so that rounding does not shut out all v."""


def least_violation(
    qp: QP, brake: Array, allow: Callable[[Backend], bool]
) -> tuple[float, Array] | None:
    """Move lo, hi and f, in place, by the least amount that lets some v of the box satisfy them.

    min ½‖s‖² + ½‖t‖² + ½ε‖v − b‖²  s.t.  lb ≤ v ≤ ub,  lo ≤ C v + s ≤ hi,  E v + t = f,
                                          −max(0, C b − hi) ≤ s ≤ max(0, lo − C b):

    the limit of an exact penalty, for what violates the rows least comes before all costs; and no
    row is violated more than by the brake b, so that one pair of geoms that should come apart never
    drives another together. Return the violation ‖[s; t]‖, which is 0 where there is room after
    all, and v (n,), which is b where none was found; None, and nothing is changed, where the time
    is over or b means nothing.

    Args:
        qp: The program, whose cost is not read.
        brake: b (n,), a v of the box.
        allow: Gives a backend the time that is left; returns whether there is any.
    """
    n, rows, equalities = qp.g.size, qp.lo.size, qp.f.size
    braked = qp.C @ brake
    gives = np.flatnonzero((qp.lo > braked) | (qp.hi < braked))  # of the others s is 0
    m = n + gives.size
    slack = QP(m + equalities, rows, equalities)
    diagonal = np.ones(m + equalities)
    diagonal[:n] = REST
    np.fill_diagonal(slack.H, diagonal)
    slack.g[:n], slack.lb[:n], slack.ub[:n] = -REST * brake, qp.lb, qp.ub
    slack.lb[n:m] = -np.maximum(0.0, braked - qp.hi)[gives]
    slack.ub[n:m] = np.maximum(0.0, qp.lo - braked)[gives]
    slack.C[:, :n], slack.lo[:], slack.hi[:] = qp.C, qp.lo, qp.hi
    slack.C[gives, n + np.arange(gives.size)] = 1.0
    slack.E[:, :n], slack.E[:, m:], slack.f[:] = qp.E, np.eye(equalities), qp.f
    certificate, solution = Certificate(slack), Solution.at_rest(slack)
    for name in ("daqp", "proxqp"):
        solver = create(name)
        if not allow(solver):
            return None
        solver.setup(slack)
        solution = solver.solve()
        if solution.status is SolveStatus.SOLVED:  # once more, from there: b is to leave no trace
            slack.g[:n] = -REST * solution.v[:n]
            solver.update(slack)
            solution = solver.solve()
        certificate.certify(solution)
        if solution.status is SolveStatus.SOLVED and solution.kkt.primal < INCONSISTENT:
            break
    else:
        if not np.isfinite(braked).all():
            return None
        solution.v[:n] = brake  # which rows may give way for
    v = solution.v[:n].copy()
    activity = qp.C @ v
    given = np.concatenate(
        [np.maximum(np.maximum(qp.lo - activity, activity - qp.hi), 0.0), qp.E @ v - qp.f]
    )
    np.minimum(qp.lo, activity - ROOM, out=qp.lo)
    np.maximum(qp.hi, activity + ROOM, out=qp.hi)
    qp.f[:] = qp.E @ v
    return math.sqrt(given.dot(given)), v
