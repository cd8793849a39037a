"""Backends and programs with known optima, which several files of tests solve."""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from programs import random_qp
from scipy.linalg import null_space
from scipy.optimize import nnls

from rmrc.qp.backends import BACKENDS, Backend, create
from rmrc.qp.backends.qpsolvers_adapter import QpsolversAdapter
from rmrc.qp.program import QP

Array = NDArray[np.float64]

KKT_TOLERANCE = 1e-8
"""What every backend must reach: 1e-8 rad/s is far below what a robot can measure."""
OBJECTIVE_TOLERANCE = 1e-8
"""Of the largest of 1 and |objective|; the independent solver is good for about 1e-11."""
SAME_VELOCITY = 1e-8
"""Two solutions of one well-conditioned program: KKT residuals of 1e-8 divided by λ_min(H) ≥ 1."""
ILL_CONDITIONED = 1e-6
"""KKT residual with cond(H) = 1e10, where ten of a float's sixteen digits are lost."""

SIZES = (1, 6, 7, 1, 6, 7, 2, 3, 12, 20, 30, 43)
KINDS = ("plain", "vertex", "fixed", "inside", "open")
COUNT = 500

BUILDERS: dict[str, Callable[[], Backend]] = {
    **{name: lambda name=name: create(name) for name in BACKENDS},
    "adapter": lambda: QpsolversAdapter("daqp"),
}


@cache
def programs(with_rows: bool) -> list[tuple[QP, float]]:
    """Return 500 seeded programs, each with its least objective."""
    rng = np.random.default_rng(2 if with_rows else 1)
    found = []
    for k in range(COUNT):
        n = SIZES[k % len(SIZES)]
        rows = int(rng.integers(1, n + 2)) if with_rows else 0
        qp = random_qp(rng, n, KINDS[k % len(KINDS)], rows)
        found.append((qp, objective(qp, least_distance_solution(qp))))
    return found


def objective(qp: QP, v: Array) -> float:
    return float(0.5 * v @ qp.H @ v + qp.g @ v)


def least_distance_solution(qp: QP) -> Array:
    """Return the optimum by non-negative least squares, which shares nothing with any backend.

    With H = LLᵀ and x = Lᵀv + L⁻¹g the program is to find the shortest x with G x ≥ h, which is
    read off the residual of one NNLS problem (Lawson and Hanson, Solving Least Squares Problems,
    1974, chapter 23). What is fixed by lb = ub or E v = f is eliminated first.
    """
    n = qp.g.size
    fixed = qp.lb == qp.ub
    equal = np.vstack([np.eye(n)[fixed], qp.E])
    values = np.concatenate([qp.lb[fixed], qp.f])
    start: Array = np.linalg.lstsq(equal, values, rcond=None)[0].astype(float)
    basis = null_space(equal) if len(equal) else np.eye(n)
    if not basis.size:
        return start
    limits = np.concatenate([qp.lb, -qp.ub, qp.lo, -qp.hi])
    real = np.isfinite(limits) & ~np.concatenate([fixed, fixed, np.zeros(2 * qp.lo.size, bool)])
    rows = np.vstack([np.eye(n), -np.eye(n), qp.C, -qp.C])[real]
    root = np.linalg.cholesky(basis.T @ qp.H @ basis)
    offset = np.linalg.solve(root, basis.T @ (qp.g + qp.H @ start))
    if not rows.size:
        return start - basis @ np.linalg.solve(root.T, offset)
    normals = np.linalg.solve(root, (rows @ basis).T)
    levels = limits[real] - rows @ start + offset @ normals
    scale, x = 1.0, offset
    for _ in range(3):  # the residual is accurate once x is scaled to length 1
        matrix = np.vstack([normals, levels / scale])
        target = np.append(np.zeros(offset.size), 1.0)
        residual = matrix @ nnls(matrix, target, maxiter=100 * n)[0] - target
        x = -scale * residual[:-1] / residual[-1]
        scale = max(float(np.linalg.norm(x)), 1e-3)
    return start + basis @ np.linalg.solve(root.T, x - offset)
