"""Damping that adapts: by manipulability, smallest singular value or error, or by direction."""

from math import prod, sqrt

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments, linear
from rmrc.reference.arguments import Array


def damping_manipulability(J: ArrayLike, maximum: float, threshold: float) -> float:
    """Return the damping λ that grows as manipulability w = √det(JJᵀ) = Πσᵢ falls.

        λ = λ_max (1 − w/w₀) for w < w₀, 0 otherwise

    which is the paper's factor k = k₀(1 − w/w₀)² with k = λ². For m > n, w is √det(JᵀJ).

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        maximum: λ_max ≥ 0, the damping at a singularity, in the units of J.
        threshold: w₀ > 0, in the units of J to the power of min(m, n).

    Returns:
        λ, in the units of J.

    Raises:
        ValueError: J is not a matrix; the maximum is negative; the threshold is not positive.

    Source: Nakamura and Hanafusa 1986; manipulability: Yoshikawa, Manipulability of robotic
    mechanisms, International Journal of Robotics Research 4(2), 1985.
    """
    sigma = np.linalg.svd(arguments.matrix("J", J), compute_uv=False)
    maximum = arguments.nonnegative("maximum", maximum)
    ratio = prod(sigma.tolist()) / arguments.positive("threshold", threshold)
    return maximum * (1.0 - ratio) if ratio < 1.0 else 0.0


def damping_sigma_min(J: ArrayLike, maximum: float, threshold: float) -> float:
    """Return the damping λ that grows as the smallest singular value falls.

        λ² = λ_max² (1 − (σ_min/ε)²) for σ_min < ε, 0 otherwise

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        maximum: λ_max ≥ 0, the damping at a singularity, in the units of J.
        threshold: ε > 0, the width of the singular region, in the units of J.

    Returns:
        λ, in the units of J.

    Raises:
        ValueError: J is not a matrix; the maximum is negative; the threshold is not positive.

    Source: Chiaverini, Singularity-robust task-priority redundancy resolution for real-time
    kinematic control of robot manipulators, IEEE Transactions on Robotics and Automation 13(3),
    1997.
    """
    sigma = np.linalg.svd(arguments.matrix("J", J), compute_uv=False)
    maximum = arguments.nonnegative("maximum", maximum)
    ratio = float(sigma[-1]) / arguments.positive("threshold", threshold)
    return maximum * sqrt(1.0 - ratio * ratio) if ratio < 1.0 else 0.0


def damping_error(error: ArrayLike, minimum: float, B: ArrayLike = 1.0) -> float:
    """Return the Levenberg–Marquardt damping λ that vanishes with the error, down to a minimum.

        λ² = ½ eᵀBe + λ_min²

    With it `weighted_dls` converges whether or not the target can be reached.

    Args:
        error: e (m,), m or rad.
        minimum: λ_min ≥ 0, the root of the paper's bias, in the units of √B·J; small against a
            link's length.
        B: weight of the squared error, symmetric positive semi-definite: a number, a diagonal
            (m,) or a matrix (m, m).

    Returns:
        λ, in the units of √B·J.

    Raises:
        ValueError: the error is not a vector; B is not symmetric positive semi-definite; the
            minimum is negative.

    Source: Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt
    method, IEEE Transactions on Robotics 27(5), 2011.
    """
    error = arguments.vector("error", error)
    B = arguments.semidefinite("B", B, error.size)
    minimum = arguments.nonnegative("minimum", minimum)
    return sqrt(0.5 * max(0.0, error @ B @ error) + minimum * minimum)


def numerically_filtered(
    J: ArrayLike, xdot: ArrayLike, filtering: float, damping: float = 0.0
) -> Array:
    """Return the joint velocity with the direction of the smallest singular value damped alone.

        v = Jᵀ(JJᵀ + λ²I + β²u_m u_mᵀ)⁻¹ẋ

    where u_m is the output direction of σ_m = σ_min: the other directions keep their accuracy.
    Where two singular values are smallest together u_m is not unique, and a small λ is needed.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        filtering: β ≥ 0, the damping of the singular direction, in the units of J; see
            `damping_sigma_min`.
        damping: λ ≥ 0, the damping of every direction, in the units of J.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: β and λ are too small for a singular J; an argument is mis-shaped.

    Source: Maciejewski and Klein, Numerical filtering for the operation of robotic manipulators
    through kinematically singular configurations, Journal of Robotic Systems 5(6), 1988;
    Chiaverini 1997.
    """
    J, xdot = arguments.task(J, xdot)
    filtering = arguments.nonnegative("filtering", filtering)
    damping = arguments.nonnegative("damping", damping)
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damped = sigma * sigma + damping * damping
    damped[-1] += filtering * filtering
    if damped.min() <= damped[0] / linear.CONDITION**2:
        raise ValueError(
            f"filtering = {filtering:.3g} and damping = {damping:.3g} are too small for this J, "
            "whose smallest singular values are zero to working precision"
        )
    return ((U.T @ xdot) * sigma / damped) @ Vt


def selectively_damped(
    J: ArrayLike,
    error: ArrayLike,
    limit: float = np.pi / 4,
    blocks: tuple[int, ...] | None = None,
) -> Array:
    """Return a step in q, each singular direction clamped by itself and the weak ones the most.

    With J = Σ σᵢuᵢvᵢᵀ and the rows of J in blocks, one for each point or rotation that is steered:

        Nᵢ = Σ_b ‖uᵢ,b‖                        how far the blocks move in direction i
        Mᵢ = σᵢ⁻¹ Σ_b Σ_j |v_ji| ‖J_b,j‖       how far the joints, each alone, move them for it
        γᵢ = (Nᵢ/Mᵢ) γ_max                     where Nᵢ ≤ Mᵢ, by the triangle inequality
        Δq = clamp_∞(Σᵢ clamp_∞(σᵢ⁻¹ ⟨uᵢ, e⟩ vᵢ, γᵢ), γ_max)

    clamp_∞(w, γ) shortens w until no entry is larger than γ. Directions of σᵢ = 0 are left out.
    The error is best clamped before (see `clamp`), to about half a link's length.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        error: e (m,), m or rad; or a velocity, in m/s or rad/s, with the limit in rad/s.
        limit: γ_max > 0, the largest change of a joint, rad.
        blocks: the number of rows of each block. By default blocks of 3 (positions, rotations)
            where m is a multiple of 3, and one block otherwise.

    Returns:
        Δq (n,), rad (rad/s for a velocity), no entry larger than the limit.

    Raises:
        ValueError: the blocks are not positive or do not add up to m; the limit is not positive;
            an argument is mis-shaped.

    Source: Buss and Kim, Selectively damped least squares for inverse kinematics, Journal of
    Graphics Tools 10(3), 2005.
    """
    J = arguments.matrix("J", J)
    rows = len(J)
    error = arguments.vector("error", error, rows)
    limit = arguments.positive("limit", limit)
    if blocks is None:
        blocks = (3,) * (rows // 3) if rows % 3 == 0 else (rows,)
    if sum(blocks) != rows or min(blocks) < 1:
        raise ValueError(
            f"blocks are {blocks}; they must be ≥ 1 and add up to the {rows} rows of J"
        )
    starts = np.cumsum((0, *blocks[:-1]))
    U, sigma, V = linear.singular_values(J, None)
    reach = np.sqrt(np.add.reduceat(U * U, starts)).sum(axis=0)  # N
    column = np.sqrt(np.add.reduceat(J * J, starts)).sum(axis=0)  # Σ_b ‖J_b,j‖
    size = abs(V)
    effort = column @ size / sigma  # M
    allowed = limit * reach / effort  # γ
    coefficient = (U.T @ error) / sigma
    largest = abs(coefficient) * size.max(axis=0)
    coefficient *= allowed / np.maximum(allowed, largest)
    step = V @ coefficient
    return step * (limit / max(limit, abs(step).max()))
