"""Damped least squares: finite joint velocities at and near singularities."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments, linear
from rmrc.reference.arguments import Array

Form = Literal["dual", "primal"]
Factorization = Literal["cholesky", "lu", "qr", "svd"]
FORMS: tuple[Form, ...] = get_args(Form)
FACTORIZATIONS: tuple[Factorization, ...] = get_args(Factorization)


def dls(
    J: ArrayLike,
    xdot: ArrayLike,
    damping: float,
    form: Form = "dual",
    factorization: Factorization = "cholesky",
) -> Array:
    """Return the damped least-squares joint velocity, the minimum of ‖Jv − ẋ‖² + λ²‖v‖².

        dual      v = Jᵀ(JJᵀ + λ²I)⁻¹ẋ     an m×m system
        primal    v = (JᵀJ + λ²I)⁻¹Jᵀẋ     an n×n system

    Both are Σ σᵢ/(σᵢ² + λ²) vᵢuᵢᵀẋ, and ‖v‖ ≤ ‖ẋ‖/2λ (see `step_bound`). Cholesky and LU factorise
    the matrix above; QR factorises [Jᵀ; λI] (dual) or [J; λI] (primal) and SVD factorises J, which
    do not square the condition number.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        damping: λ ≥ 0, in the units of J. With λ = 0 this is the pseudo-inverse, and the
            matrix above must be regular.
        form: `dual` or `primal`; the same for SVD.
        factorization: `cholesky`, `lu`, `qr` or `svd`.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: the damping is negative, or too small for a singular J; an argument is
            mis-shaped.

    Source: Wampler, Manipulator inverse kinematic solutions based on vector formulations and
    damped least-squares methods, IEEE Transactions on SMC 16(1), 1986; Nakamura and Hanafusa,
    Inverse kinematic solutions with singularity robustness for robot manipulator control, Journal
    of Dynamic Systems, Measurement, and Control 108(3), 1986.
    """
    J, xdot = arguments.task(J, xdot)
    damping = arguments.nonnegative("damping", damping)
    arguments.choice("form", form, FORMS)
    arguments.choice("factorization", factorization, FACTORIZATIONS)
    dual = form == "dual"
    k = linear.power(J, damping)
    J, scaled = np.ldexp(J, -k), float(np.ldexp(damping, -k))
    match factorization:
        case "svd":
            v = _by_singular_values(J, xdot, scaled)
        case "qr":
            v = _by_qr(J, xdot, scaled, dual)
        case _:
            solve = linear.solve_cholesky if factorization == "cholesky" else linear.solve_lu
            H = J @ J.T if dual else J.T @ J
            H.flat[:: len(H) + 1] += scaled * scaled
            v = solve(H, xdot if dual else J.T @ xdot)
            if dual and v is not None:
                v = J.T @ v
    if v is None:
        raise ValueError(
            f"damping = {damping:.3g} is too small for this J: "
            f"{'JJᵀ' if dual else 'JᵀJ'} + λ²I is singular to working precision"
        )
    return np.ldexp(v, -k)


def _by_qr(J: Array, xdot: Array, damping: float, dual: bool) -> Array | None:
    A = J.T if dual else J
    rows, columns = A.shape
    stacked = np.zeros((rows + columns, columns))
    stacked[:rows] = A
    stacked[rows:].flat[:: columns + 1] = damping
    Q, R = np.linalg.qr(stacked)
    inverse = linear.invert(R)
    if inverse is None:
        return None
    # A = QR in the upper rows and RᵀR = AᵀA + λ²I, so A R⁻¹ = Q.
    return Q[:rows] @ (inverse.T @ xdot) if dual else inverse @ (Q[:rows].T @ xdot)


def _by_singular_values(J: Array, xdot: Array, damping: float) -> Array | None:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damped = sigma * sigma + damping * damping
    if damped[-1] <= damped[0] / linear.CONDITION**2:
        return None
    return ((U.T @ xdot) * sigma / damped) @ Vt


def weighted_dls(
    J: ArrayLike, xdot: ArrayLike, A: ArrayLike, B: ArrayLike, damping: float
) -> Array:
    """Return the minimum of ½‖Jv − ẋ‖²_B + ½‖v‖²_A + ½λ²‖v‖².

        v = (JᵀBJ + A + λ²I)⁻¹JᵀBẋ

    It is the quadratic program of one task when no limit is active.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        A: joint metric, symmetric positive semi-definite: a number, a diagonal (n,) or a
            matrix (n, n), in the units of BJ².
        B: task weight, symmetric positive semi-definite: a number, a diagonal (m,) or a
            matrix (m, m).
        damping: λ ≥ 0, in the units of √B·J.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: JᵀBJ + A + λ²I is singular; A or B is not symmetric positive semi-definite; an
            argument is mis-shaped.

    Source: Whitney 1969 (A and B); Nakamura and Hanafusa 1986 (weights and damping).
    """
    J, xdot = arguments.task(J, xdot)
    A = arguments.semidefinite("A", A, J.shape[1])
    B = arguments.semidefinite("B", B, len(J))
    damping = arguments.nonnegative("damping", damping)
    j, b, a, d = linear.power(J), linear.power(B), linear.power(A), linear.power(damping)
    J, B, A, damping = np.ldexp(J, -j), np.ldexp(B, -b), np.ldexp(A, -a), np.ldexp(damping, -d)
    h = max(2 * j + b, a, 2 * d)
    weighted = J.T @ B
    H = np.ldexp(weighted @ J, 2 * j + b - h)
    H += np.ldexp(A, a - h)
    H.flat[:: len(H) + 1] += np.ldexp(damping * damping, 2 * d - h)
    v = linear.solve_lu(H, weighted @ xdot)
    if v is None:
        raise ValueError(
            "A, B, damping: JᵀBJ + A + λ²I is singular to working precision; raise A or the damping"
        )
    return np.ldexp(v, j + b - h)


def step_bound(xdot: ArrayLike, damping: float) -> float:
    """Return the bound that damped least squares puts on the joint velocity, ‖v‖ ≤ ‖ẋ‖/2λ.

    It holds for every J, since σ/(σ² + λ²) ≤ 1/2λ, with equality where σ = λ and ẋ is along that
    singular direction.

    Args:
        xdot: task velocity ẋ (m,), m/s or rad/s.
        damping: λ > 0, in the units of J.

    Returns:
        The bound on ‖v‖, rad/s.

    Raises:
        ValueError: the damping is not positive; xdot is not a vector.

    Source: Deo and Walker, Overview of damped least-squares methods for inverse kinematics of
    robot manipulators, Journal of Intelligent and Robotic Systems 14, 1995.
    """
    xdot = arguments.vector("xdot", xdot)
    return float(np.linalg.norm(xdot)) / (2.0 * arguments.positive("damping", damping))
