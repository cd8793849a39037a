"""Checks of arguments: each returns the argument in float64 or raises a ValueError naming it."""

from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# ‖W − Wᵀ‖ and negative eigenvalues up to this share of ‖W‖ are rounding: products such as JᵀBJ are
# off by 1e-16.
ROUNDING = 1e-10


def _array(name: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is not an array of numbers") from None


def _finite(name: str, array: Array) -> Array:
    # One dot product costs a third of np.isfinite(array).all().
    if not isfinite(np.vdot(array, array)):
        raise ValueError(f"{name} has entries that are not finite, or too large to be squared")
    return array


def matrix(name: str, value: ArrayLike) -> Array:
    """Return a finite matrix with at least one row and one column."""
    array = _array(name, value)
    if array.ndim != 2 or not array.size:
        raise ValueError(f"{name} has shape {array.shape}; it must be (m, n) with m, n ≥ 1")
    return _finite(name, array)


def vector(name: str, value: ArrayLike, size: int | None = None) -> Array:
    """Return a finite vector, of the given size if there is one."""
    array = _array(name, value)
    if array.ndim != 1 or not array.size or (size is not None and array.size != size):
        wanted = "(n,) with n ≥ 1" if size is None else f"({size},)"
        raise ValueError(f"{name} has shape {array.shape}; it must be {wanted}")
    return _finite(name, array)


def task(J: ArrayLike, xdot: ArrayLike, where: str = "") -> tuple[Array, Array]:
    """Return a Jacobian (m, n) and its task velocity (m,)."""
    J = matrix(where + "J", J)
    array = _array(where + "xdot", xdot)
    if array.shape != J.shape[:1]:
        raise ValueError(
            f"{where}xdot has shape {array.shape}; for J of shape {J.shape} it must be ({len(J)},)"
        )
    return J, _finite(where + "xdot", array)


def symmetric(name: str, value: ArrayLike, size: int) -> Array:
    """Return a symmetric matrix given as a number (times the identity), its diagonal or whole."""
    array = _array(name, value)
    if array.shape == (size, size):
        skew = _finite(name, array) - array.T
        if np.vdot(skew, skew) > ROUNDING**2 * np.vdot(array, array):
            raise ValueError(f"{name} is not symmetric")
        return array
    if array.ndim and array.shape != (size,):
        raise ValueError(
            f"{name} has shape {array.shape}; it must be a number, ({size},) or ({size}, {size})"
        )
    diagonal = np.zeros((size, size))
    diagonal.flat[:: size + 1] = _finite(name, array)
    return diagonal


def semidefinite(name: str, value: ArrayLike, size: int) -> Array:
    """Return a symmetric positive semi-definite matrix, given as for `symmetric`."""
    array = symmetric(name, value, size)
    if np.ndim(value) == 2:
        try:
            np.linalg.cholesky(array)  # settles the definite ones sooner than the eigenvalues
            return array
        except np.linalg.LinAlgError:
            eigenvalues = np.linalg.eigvalsh(array)
            least, tolerance = eigenvalues[0], ROUNDING * abs(eigenvalues).max()
    else:
        least, tolerance = array.diagonal().min(), 0.0
    if least < -tolerance:
        raise ValueError(
            f"{name} is not positive semi-definite: its least eigenvalue is {least:.3g}"
        )
    return array


def bounds(lower: ArrayLike, upper: ArrayLike, size: int) -> tuple[Array, Array]:
    """Return the ends of a box (size,), given as numbers or vectors; infinite ones are none."""
    ends: list[Array] = []
    for name, value in (("lower", lower), ("upper", upper)):
        array = _array(name, value)
        if array.ndim == 0:
            array = np.full(size, array)
        if array.shape != (size,):
            raise ValueError(f"{name} has shape {array.shape}; it must be a number or ({size},)")
        ends.append(array)
    low, high = ends
    admits = (low <= high) & (low < inf) & (high > -inf)  # false for NaN
    if not admits.all():
        k = int(admits.argmin())
        raise ValueError(
            f"nothing is between lower[{k}] = {low[k]:.6g} and upper[{k}] = {high[k]:.6g}"
        )
    return low, high


def nonnegative(name: str, value: float) -> float:
    """Return a finite number ≥ 0."""
    if not 0.0 <= value < inf:
        raise ValueError(f"{name} is {value}; it must be finite and ≥ 0")
    return float(value)


def positive(name: str, value: float) -> float:
    """Return a finite number > 0."""
    if not 0.0 < value < inf:
        raise ValueError(f"{name} is {value}; it must be finite and > 0")
    return float(value)


def choice(name: str, value: str, known: tuple[str, ...]) -> None:
    """Check that a word is one of the known ones."""
    if value not in known:
        raise ValueError(f"{name} is {value!r}; it must be one of {', '.join(map(repr, known))}")
