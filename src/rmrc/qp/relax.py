"""Rows and equalities that cannot hold together: the least by which they have to give way."""

import math

import numpy as np

from rmrc.qp.backends import create
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, SolveStatus

INCONSISTENT = 1e-6
"""Largest residual of equalities that agree with one another, rad/s or m/s."""
REST = 1e-10
"""Weight of ‖v‖² beside that of the violations."""
ROOM = 1e-9
"""What is added to the least violation, so that rounding does not shut out all v."""


def least_violation(qp: QP) -> float | None:
    """Move lo, hi and f, in place, by the least amount that lets some v of the box satisfy them.

    min ½‖s‖² + ½‖t‖² + ½ε‖v‖²  s.t.  lb ≤ v ≤ ub, lo ≤ C v + s ≤ hi, E v + t = f: the limit of an
    exact penalty, for what violates the rows least comes before all costs. Return the violation,
    ‖[s; t]‖, which is 0 where there is room after all; None, and nothing is changed, where it was
    not found.
    """
    n, rows, equalities = qp.g.size, qp.lo.size, qp.f.size
    slack = QP(n + rows + equalities, rows, equalities)
    slack.H.flat[:: slack.g.size + 1] = 1.0
    slack.H.flat[: n * (slack.g.size + 1) : slack.g.size + 1] = REST
    slack.lb[:n], slack.ub[:n] = qp.lb, qp.ub
    slack.C[:, :n], slack.lo[:], slack.hi[:] = qp.C, qp.lo, qp.hi
    slack.C[:, n : n + rows] = np.eye(rows)
    slack.E[:, :n], slack.E[:, n + rows :], slack.f[:] = qp.E, np.eye(equalities), qp.f
    certificate = Certificate(slack)
    for name in ("daqp", "proxqp"):
        solver = create(name)
        solver.setup(slack)
        solution = solver.solve()
        certificate.certify(solution)
        if solution.status is SolveStatus.SOLVED and solution.kkt.primal < INCONSISTENT:
            break
    else:
        return None
    v = solution.v[:n]
    activity = qp.C @ v
    np.minimum(qp.lo, activity - ROOM, out=qp.lo)
    np.maximum(qp.hi, activity + ROOM, out=qp.hi)
    qp.f[:] = qp.E @ v
    violation = solution.v[n:]
    return math.sqrt(violation.dot(violation))
