"""Undamped resolved rates: inverse, transpose, pseudo-inverse and the weighted least norm."""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments, linear
from rmrc.reference.arguments import Array


def inverse(J: ArrayLike, xdot: ArrayLike) -> Array:
    """Return the joint velocity of a square Jacobian, v = J⁻¹ẋ.

    Args:
        J: Jacobian (n, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (n,), m/s or rad/s.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: J is not square, or singular to working precision; an argument is mis-shaped.

    Source: Whitney, Resolved motion rate control of manipulators and human prostheses, IEEE
    Transactions on Man-Machine Systems 10(2), 1969.
    """
    J, xdot = arguments.task(J, xdot)
    rows, columns = J.shape
    if rows != columns:
        raise ValueError(f"J has shape {J.shape}; only a square J has an inverse: see pinv")
    v = linear.solve_lu(J, xdot)
    if v is None:
        raise ValueError("J is singular: pinv and dls are defined where the inverse is not")
    return v


def transpose(J: ArrayLike, xdot: ArrayLike, gain: float | None = None) -> Array:
    """Return a step along the transpose, v = αJᵀẋ, which descends on ½‖ẋ − Jv‖².

    The optimal step, the default, minimises ‖ẋ − αJJᵀẋ‖:

        α = ⟨ẋ, JJᵀẋ⟩ / ‖JJᵀẋ‖²

    Where Jᵀẋ = 0 no step helps and v = 0. A given gain bounds the step, ‖v‖ ≤ ασ₁‖ẋ‖; the optimal
    one does not when ẋ lies in a nearly lost direction alone.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s; or an error e, in m or rad, for a step in q.
        gain: α, in the units of 1/J², to take instead of the optimal one.

    Returns:
        v (n,), rad/s (rad for an error).

    Raises:
        ValueError: an argument is mis-shaped; the gain is negative or not finite.

    Source: Balestrino, De Maria and Sciavicco, Robust control of robotic manipulators, IFAC World
    Congress, 1984; Wolovich and Elliott, A computational technique for inverse kinematics, IEEE
    CDC, 1984. The optimal α: Buss, Introduction to inverse kinematics with Jacobian transpose,
    pseudoinverse and damped least squares methods, 2004.
    """
    J, xdot = arguments.task(J, xdot)
    if gain is not None:
        return arguments.nonnegative("gain", gain) * (J.T @ xdot)
    k, of_rate = linear.power(J), linear.power(xdot)
    J, xdot = np.ldexp(J, -k), np.ldexp(xdot, -of_rate)
    direction = J.T @ xdot
    length = math.sqrt(direction.dot(direction))
    if not length:
        return direction
    direction /= length
    moved = J @ direction
    return np.ldexp(length / moved.dot(moved) * direction, of_rate - k)


def pinv(
    J: ArrayLike,
    xdot: ArrayLike,
    form: Literal["general", "right"] = "general",
    tolerance: float | None = None,
) -> Array:
    """Return the least-norm joint velocity among those nearest to the task, v = J⁺ẋ.

        general   J⁺ = Σ vᵢuᵢᵀ/σᵢ over σᵢ > tolerance · σ₁, for any J
        right     J⁺ = Jᵀ(JJᵀ)⁻¹, for J of full row rank

    The right form squares the condition number of J: it loses twice the digits near a singularity.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        form: `general` (by singular values) or `right`.
        tolerance: share of σ₁ up to which a singular value counts as zero in the general form;
            max(m, n) ε by default.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: an argument is mis-shaped; in the right form, JJᵀ is singular.

    Source: Whitney 1969 (right form); Klein and Huang, Review of pseudoinverse control for use
    with kinematically redundant manipulators, IEEE Transactions on SMC 13(2), 1983.
    """
    J, xdot = arguments.task(J, xdot)
    arguments.choice("form", form, ("general", "right"))
    if form == "general":
        U, sigma, V = linear.singular_values(J, tolerance)
        return V @ ((U.T @ xdot) / sigma)
    k = linear.power(J)
    J = np.ldexp(J, -k)
    multiplier = linear.solve_lu(J @ J.T, xdot)
    if multiplier is None:
        raise ValueError(
            "J: JJᵀ is singular, the right pseudo-inverse needs full row rank: see form='general'"
        )
    return np.ldexp(J.T @ multiplier, -k)


def weighted(J: ArrayLike, xdot: ArrayLike, A: ArrayLike) -> Array:
    """Return the joint velocity of least ½vᵀAv among those that hold the task exactly.

        v = A⁻¹Jᵀ(JA⁻¹Jᵀ)⁻¹ẋ = L⁻ᵀQR⁻ᵀẋ    with A = LLᵀ and L⁻¹Jᵀ = QR

    The factorization of the weighted Jacobian does not square its condition number.

    Args:
        J: Jacobian (m, n) of full row rank, rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        A: metric, symmetric positive definite: a number, a diagonal (n,) or a matrix (n, n). The
            mass matrix M(q), in kg·m², minimises kinetic energy.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: A is not symmetric positive definite; J lacks full row rank; an argument is
            mis-shaped.

    Source: Whitney 1969.
    """
    J, xdot = arguments.task(J, xdot)
    A = arguments.symmetric("A", A, J.shape[1])
    k = linear.power(J)
    J, A = np.ldexp(J, -k), np.ldexp(A, -linear.power(A))
    root = linear.invert_factor(A)  # L⁻¹
    if root is None:
        raise ValueError("A is not positive definite: see weighted_dls for a semi-definite metric")
    Q, R = np.linalg.qr(root @ J.T)
    inverse = linear.invert(R)
    if inverse is None:
        raise ValueError("J: JA⁻¹Jᵀ is singular, J lacks full row rank: see weighted_dls")
    return np.ldexp(root.T @ (Q @ (inverse.T @ xdot)), -k)


def task_metric(J: ArrayLike, B: ArrayLike, damping: float = 0.0) -> Array:
    """Return the joint-space metric of a task weight, A = JᵀBJ + λ²I.

    With λ = 0, vᵀAv = ‖Jv‖²_B: `weighted` with this A moves the task of this J the least. Such an
    A is singular as soon as BJ leaves a joint motion unseen, as it does for every J with m < n;
    it is then no metric, and that is an error. A damping λ > 0 weighs the unseen motion.

    Args:
        J: Jacobian (m, n) of the task that is to move little, rows in m/rad or rad/rad.
        B: its weight, symmetric positive semi-definite: a number, a diagonal (m,) or a
            matrix (m, m).
        damping: λ ≥ 0, in the units of √B·J.

    Returns:
        A (n, n), symmetric positive definite.

    Raises:
        ValueError: A is singular (the message says its rank); B is not symmetric positive
            semi-definite; an argument is mis-shaped.

    Source: Whitney 1969.
    """
    J = arguments.matrix("J", J)
    B = arguments.semidefinite("B", B, len(J))
    damping = arguments.nonnegative("damping", damping)
    A = J.T @ B @ J
    A.flat[:: len(A) + 1] += damping * damping
    if linear.invert_factor(A) is None:
        rank = np.linalg.matrix_rank(A, hermitian=True)
        raise ValueError(
            f"J, B: the metric A = JᵀBJ is singular, of rank {rank} for {len(A)} joints: "
            "a damping > 0 gives JᵀBJ + λ²I"
        )
    return A
