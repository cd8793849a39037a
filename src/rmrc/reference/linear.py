"""Solutions of small linear systems that notice a singular matrix, which LAPACK does not."""

from typing import NamedTuple, cast

import numpy as np

from rmrc.reference.arguments import Array

EPSILON = float(np.finfo(np.float64).eps)
# Beyond this condition number fewer than two digits are left: singular to working precision.
CONDITION = 0.01 / EPSILON


# Powers of 2 within which a number has an inverse.
_LARGEST_POWER = 1000


def power(*values: Array | float) -> int:
    """Return the k for which the largest element is between 2ᵏ⁻¹ and 2ᵏ; that of zeros is small.

    What is divided by 2ᵏ keeps its digits, and has squares that neither overflow nor vanish.
    """
    largest = max(float(np.abs(value).max()) for value in values)
    k = int(np.frexp(largest)[1]) if largest > 0.0 else -_LARGEST_POWER
    return min(max(k, -_LARGEST_POWER), _LARGEST_POWER)


def invert(matrix: Array) -> Array | None:
    """Return the inverse by LU; None if the matrix is singular to working precision.

    At the sizes of a robot an inverse costs what a solution costs, and it gives the condition
    number ‖M‖‖M⁻¹‖ (Frobenius) as well.
    """
    try:
        inverse = cast(Array, np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return None
    condition_squared = np.vdot(matrix, matrix) * np.vdot(inverse, inverse)
    return inverse if condition_squared < CONDITION**2 else None


def invert_factor(matrix: Array) -> Array | None:
    """Return L⁻¹ of M = LLᵀ (Cholesky); None if M is not positive definite to working precision.

    The condition number is bounded by tr(M) tr(M⁻¹) = ‖L‖²‖L⁻¹‖².
    """
    try:
        factor = np.linalg.cholesky(matrix)
        inverse = cast(Array, np.linalg.inv(factor))
    except np.linalg.LinAlgError:
        return None
    condition = np.vdot(factor, factor) * np.vdot(inverse, inverse)
    return inverse if condition < CONDITION else None


def solve_lu(matrix: Array, right: Array) -> Array | None:
    """Return M⁻¹ b by LU; None if M is singular to working precision."""
    inverse = invert(matrix)
    return None if inverse is None else inverse @ right


def solve_cholesky(matrix: Array, right: Array) -> Array | None:
    """Return M⁻¹ b by Cholesky; None if M is not positive definite to working precision."""
    inverse = invert_factor(matrix)
    return None if inverse is None else inverse.T @ (inverse @ right)


class SingularValues(NamedTuple):
    """The singular value decomposition M = U diag(σ) Vᵀ without the values that count as zero."""

    U: Array
    """(m, r)."""
    sigma: Array
    """(r,), descending, in the units of M."""
    V: Array
    """(n, r)."""


def singular_values(matrix: Array, tolerance: float | None) -> SingularValues:
    """Return the thin decomposition of the singular values above `tolerance` times the largest.

    By default the tolerance is max(m, n) ε, the size of the rounding errors.
    """
    U, sigma, Vt = np.linalg.svd(matrix, full_matrices=False)
    if tolerance is None:
        tolerance = EPSILON * max(matrix.shape)
    elif not 0.0 <= tolerance < 1.0:
        raise ValueError(f"tolerance is {tolerance}; it must be ≥ 0 and < 1")
    if sigma[-1] > tolerance * sigma[0]:
        return SingularValues(U, sigma, Vt.T)
    rank = int(np.count_nonzero(sigma > tolerance * sigma[0]))
    return SingularValues(U[:, :rank], sigma[:rank], Vt[:rank].T)
