"""Random programs like those of a robot, and their certified solutions."""

from collections.abc import Iterator

import numpy as np

from rmrc.qp.backends import Backend
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Solution


def random_qp(rng: np.random.Generator, n: int, kind: str = "plain", rows: int = 0) -> QP:
    """Return a feasible program like those of a robot: H = JᵀJ + λ²I, limits of the order of 1.

    Kinds: `vertex` has its optimum in a corner of the box, with every other multiplier 0; `fixed`
    has lb = ub on about a third of the variables; `inside` no active limit; `open` half of its
    bounds infinite. Rows are two-sided, one-sided, equal on both sides, and some are there twice;
    with four rows or more, and three variables, one in three programs has equalities too.
    """
    equalities = n // 3 if rows >= 4 and kind != "fixed" and rng.random() < 0.4 else 0
    qp = QP(n, rows, equalities)
    jacobian = rng.normal(size=(int(rng.integers(max(1, n // 2), 2 * n + 1)), n))
    qp.H[:] = jacobian.T @ jacobian + rng.choice([1e-4, 1e-2]) * np.eye(n)
    qp.g[:] = -3.0 * jacobian.T @ rng.normal(size=jacobian.shape[0])
    middle, half = 0.3 * rng.normal(size=n), rng.uniform(0.1, 2.0, size=n)
    qp.lb[:], qp.ub[:] = middle - half, middle + half
    if kind == "fixed":
        fixed = rng.random(n) < 0.3
        qp.ub[fixed] = qp.lb[fixed]
    elif kind == "inside":
        qp.g[:] = -qp.H @ middle
    elif kind == "vertex":
        side = np.where(rng.random(n) < 0.5, 1.0, -1.0)
        multiplier = side * rng.uniform(0.0, 1.0, n) * (np.arange(n) % 2 == 0)
        qp.g[:] = -qp.H @ (middle + side * half) - multiplier
    feasible = middle + half * rng.uniform(-0.9, 0.9, size=n) * (qp.lb < qp.ub)
    feasible = np.where(qp.lb == qp.ub, qp.lb, feasible)
    if kind == "open":
        qp.lb[rng.random(n) < 0.5] = -np.inf
        qp.ub[rng.random(n) < 0.5] = np.inf
    qp.C[:] = rng.normal(size=(rows, n))
    copies = rows // 4
    qp.C[:copies] = qp.C[copies : 2 * copies]
    activity = qp.C @ feasible
    qp.lo[:] = activity - rng.uniform(0.0, 0.5, size=rows)
    qp.hi[:] = activity + rng.choice([0.0, 0.3, np.inf], p=[0.1, 0.5, 0.4], size=rows)
    qp.E[:] = rng.normal(size=(equalities, n))
    qp.f[:] = qp.E @ feasible
    return qp


def solved(backend: Backend, qp: QP) -> Solution:
    """Return the certified solution of one setup and solve."""
    backend.setup(qp)
    solution = backend.solve()
    Certificate(qp).certify(solution)
    return solution


def copy_into(target: QP, source: QP) -> None:
    for name in ("H", "g", "lb", "ub", "C", "lo", "hi", "E", "f"):
        getattr(target, name)[:] = getattr(source, name)


def copy_of(qp: QP) -> QP:
    other = QP(qp.g.size, qp.lo.size, qp.f.size)
    copy_into(other, qp)
    return other


def moving_program(rng: np.random.Generator, n: int, rows: int, steps: int) -> Iterator[QP]:
    """Yield one program again and again, changed in place as from step to step of a robot."""
    qp = random_qp(rng, n, "plain", rows)
    qp.H[:] += np.eye(n)
    center = copy_of(qp)
    for _ in range(steps):
        change = 0.1 * rng.normal(size=(2, n))
        qp.H[:] = center.H + change.T @ change
        qp.g[:] = center.g + rng.normal(size=n)
        shift = 0.2 * rng.normal(size=n)
        qp.lb[:], qp.ub[:] = center.lb + shift, center.ub + shift
        # Limits come, go, and close in on a single value.
        qp.lb[rng.random(n) < 0.1] = -np.inf
        qp.ub[rng.random(n) < 0.1] = np.inf
        closed = np.isfinite(qp.lb) & (rng.random(n) < 0.1)
        qp.ub[closed] = qp.lb[closed]
        qp.C[:] = center.C + 0.1 * rng.normal(size=qp.C.shape)
        inside = np.clip(shift, qp.lb, qp.ub)
        width = rng.choice([0.2, np.inf], size=rows)
        qp.lo[:], qp.hi[:] = qp.C @ inside - 0.1, qp.C @ inside + width
        qp.f[:] = qp.E @ inside
        yield qp
