"""Null space: its projector, and tasks in strict order of priority."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments, linear
from rmrc.reference.arguments import Array


def nullspace_projector(J: ArrayLike, tolerance: float | None = None) -> Array:
    """Return the orthogonal projector on the joint velocities that do not move the task.

        N = I − J⁺J,  JN = 0,  N² = N = Nᵀ

    v = J⁺ẋ + Nv₀ is the joint velocity nearest to v₀ among those nearest to the task.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        tolerance: share of σ₁ up to which a singular value counts as zero; max(m, n) ε by default.

    Returns:
        N (n, n), without units.

    Raises:
        ValueError: J is not a matrix; the tolerance is negative.

    Source: Liégeois, Automatic supervisory control of the configuration and behavior of multibody
    mechanisms, IEEE Transactions on SMC 7(12), 1977.
    """
    J = arguments.matrix("J", J)
    V = linear.singular_values(J, tolerance).V
    N = V @ -V.T
    N.flat[:: len(N) + 1] += 1.0
    return N


def prioritized(
    levels: Iterable[tuple[ArrayLike, ArrayLike]], damping: float = 0.0, tolerance: float = 1e-10
) -> Array:
    """Return the joint velocity of tasks in strict order: none disturbs the ones before it.

        v_k = v_{k−1} + (J_kN_{k−1})⁺(ẋ_k − J_kv_{k−1}),            v₀ = 0
        N_k = N_{k−1} − (J_kN_{k−1})⁺(J_kN_{k−1}),                  N₀ = I

    With a damping λ the inverse in the first line is the damped one, (·)ᵀ((·)(·)ᵀ + λ²I)⁻¹: it
    bounds the rates where a level loses rank in the null space of those before it. The projector
    is not damped, so the order stays strict.

    Args:
        levels: pairs (J_k, ẋ_k), the highest priority first: Jacobians (m_k, n) with rows in m/rad
            or rad/rad and task velocities (m_k,) in m/s or rad/s.
        damping: λ ≥ 0, in the units of J.
        tolerance: share of ‖J_k‖ up to which a singular value of J_kN_{k−1} counts as zero.

    Returns:
        v (n,), rad/s.

    Raises:
        ValueError: there is no level; a level is mis-shaped (the message says which); the
            Jacobians differ in n; the damping or the tolerance is negative.

    Source: Siciliano and Slotine, A general framework for managing multiple tasks in highly
    redundant robotic systems, ICAR 1991; the projector: Baerlocher and Boulic, Task-priority
    formulations for the kinematic control of highly redundant articulated structures, IROS 1998.
    """
    damping = arguments.nonnegative("damping", damping)
    tolerance = arguments.nonnegative("tolerance", tolerance)
    tasks = [arguments.task(J, xdot, f"levels[{k}]: ") for k, (J, xdot) in enumerate(levels)]
    if not tasks:
        raise ValueError("levels is empty; it must have at least one (J, xdot)")
    columns = tasks[0][0].shape[1]
    v, N = np.zeros(columns), np.eye(columns)
    for k, (J, xdot) in enumerate(tasks):
        if J.shape[1] != columns:
            raise ValueError(
                f"levels[{k}]: J has {J.shape[1]} columns; it must have {columns} as in levels[0]"
            )
        U, sigma, Vt = np.linalg.svd(J @ N, full_matrices=False)
        # Relative to J, not to JN: of a task that conflicts with those before, JN is rounding.
        rank = int(np.count_nonzero(sigma > tolerance * np.linalg.norm(J)))
        U, sigma = U[:, :rank], sigma[:rank]
        # Rounding tilts the directions of small σ out of the null space; N takes them back.
        V = N @ Vt[:rank].T
        v += V @ (sigma / (sigma * sigma + damping * damping) * (U.T @ (xdot - J @ v)))
        N -= V @ V.T
    return v
