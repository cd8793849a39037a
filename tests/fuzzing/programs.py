"""Hostile programs straight into the solver: it answers, and nothing of them is left in it."""

import numpy as np

from fuzzing.numbers import Array, Generator, among, numbers, sizes
from rmrc import _native
from rmrc.qp.program import SolveStatus

STATUSES = {status.value for status in SolveStatus}
MOST_ITERATIONS = 500
SAME = 1e-9
"""Of v, from a cold start and after hostile programs, relative to the largest of 1 and ‖v‖."""
INSIDE = 1e-6
"""By how much a solution may pass a bound, relative to the largest of 1 and the bound."""
Program = tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]
"""H, g, lb, ub, C, lo, hi, E and f."""


def hessian(rng: Generator, n: int, hostile: float) -> Array:
    """Return H (n, n): definite, nearly singular, indefinite, or no matrix to speak of."""
    root = numbers(rng, n, n, hostile=hostile)
    with np.errstate(all="ignore"):
        match rng.integers(6) if rng.random() < hostile else 0:
            case 0:
                return root.T @ root + 1e-3 * np.eye(n)
            case 1:
                return root + root.T  # indefinite
            case 2:
                return np.outer(root[0], root[0])
            case 3:
                return -(root.T @ root)
            case 4:
                return np.diag(root[0])
            case _:
                return root


def bounds(rng: Generator, middle: Array, hostile: float) -> tuple[Array, Array]:
    """Return limits around some values, some of them absent, equal or, if hostile, crossed."""
    size = middle.size
    lower, upper = middle - rng.exponential(size=size), middle + rng.exponential(size=size)
    lower[rng.random(size) < 0.2], upper[rng.random(size) < 0.2] = -np.inf, np.inf
    equal = rng.random(size) < 0.1
    lower[equal] = upper[equal] = middle[equal]
    if size and rng.random() < hostile:
        match rng.integers(4):
            case 0:
                lower, upper = upper, lower
            case 1:
                lower = numbers(rng, size, hostile=1.0)
            case 2:
                upper = numbers(rng, size, hostile=1.0)
            case _:
                lower[:], upper[:] = -np.inf, np.inf
    return lower, upper


def program(rng: Generator, n: int, rows: int, equalities: int, hostile: float) -> Program:
    """Return the arrays of a program, in the order in which the solver takes them."""
    v = rng.normal(size=n)
    C, E = numbers(rng, rows, n, hostile=hostile), numbers(rng, equalities, n, hostile=hostile)
    if rows > 1 and rng.random() < 0.3:
        C[rows // 2 :] = C[: rows - rows // 2]
    with np.errstate(all="ignore"):
        f = E @ v
        lower, upper = bounds(rng, C @ v, hostile)
    if rng.random() < hostile:
        f = numbers(rng, equalities, hostile=1.0)
    return (
        hessian(rng, n, hostile),
        numbers(rng, n, hostile=hostile),
        *bounds(rng, v, hostile),
        C,
        lower,
        upper,
        E,
        f,
    )


def run(rng: Generator) -> int:
    """Solve a few programs one after the other, and between them one that is sane."""
    n, rows = 1 + sizes(rng, 59), sizes(rng, 60)
    equalities = min(sizes(rng, 60), int(among(rng, n, 60)))
    solver = _native.QPSolver(n, rows, equalities, MOST_ITERATIONS)
    sane = program(rng, n, rows, min(equalities, n // 2), 0.0)
    cold = _native.QPSolver(n, rows, equalities, MOST_ITERATIONS).solve(*sane)
    count = int(rng.integers(1, 8))
    for _ in range(count):
        found = program(rng, n, sizes(rng, rows), sizes(rng, equalities), 0.5)
        seconds = float(among(rng, np.inf, np.inf, np.nan, -1.0, 1e-5, 1e300))
        check(found, solver.solve(*found, seconds))
        again = solver.solve(*sane)
        assert again[5] == cold[5] or "max_iter" in (again[5], cold[5]), (again[5], cold[5])
        if again[5] == cold[5] == "solved":
            scale = max(1.0, float(np.abs(cold[0]).max()))
            assert np.abs(again[0] - cold[0]).max() <= SAME * scale
    return count


def check(given: Program, answer: tuple[Array, Array, Array, Array, int, str]) -> None:
    """Hold an answer to what every answer promises."""
    v, z, y, w, iterations, status = answer
    assert status in STATUSES
    most = MOST_ITERATIONS + v.size + y.size  # those that a working set is rid of come on top
    assert iterations <= 2 * most
    assert all(np.isfinite(part).all() for part in (v, z, y, w))
    if status != "solved":
        assert not v.any()
        return
    lower, upper = given[2], given[3]
    assert (v >= lower - INSIDE * np.maximum(1.0, np.abs(lower))).all()
    assert (v <= upper + INSIDE * np.maximum(1.0, np.abs(upper))).all()
