"""The planar arm with two links in closed form: a check on everything else.

q = (q₁, q₂) in rad, q₂ relative to the first link; l₁, l₂ in m; s₁₂ stands for sin(q₁ + q₂).
"""

from math import atan2, cos, hypot, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments
from rmrc.reference.arguments import Array
from rmrc.reference.linear import EPSILON


def _lengths(lengths: tuple[float, float]) -> tuple[float, float]:
    first, second = arguments.vector("lengths", lengths, 2).tolist()
    return arguments.positive("lengths[0]", first), arguments.positive("lengths[1]", second)


def forward(q: ArrayLike, lengths: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Return the position of the tip, x = (l₁c₁ + l₂c₁₂, l₁s₁ + l₂s₁₂).

    Args:
        q: joint angles (2,), rad.
        lengths: l₁ and l₂, m.

    Returns:
        x (2,), m.

    Raises:
        ValueError: q is not (2,) and finite; a length is not positive.

    Source: Craig, Introduction to Robotics, the two-link planar arm.
    """
    q1, q2 = arguments.vector("q", q, 2).tolist()
    l1, l2 = _lengths(lengths)
    return np.array([l1 * cos(q1) + l2 * cos(q1 + q2), l1 * sin(q1) + l2 * sin(q1 + q2)])


def jacobian(q: ArrayLike, lengths: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Return the Jacobian of the tip's position, J = [−l₁s₁ − l₂s₁₂, −l₂s₁₂; l₁c₁ + l₂c₁₂, l₂c₁₂].

    Args:
        q: joint angles (2,), rad.
        lengths: l₁ and l₂, m.

    Returns:
        J (2, 2), m/rad, with det J = l₁l₂ sin q₂.

    Raises:
        ValueError: q is not (2,) and finite; a length is not positive.

    Source: Craig, as for `forward`.
    """
    q1, q2 = arguments.vector("q", q, 2).tolist()
    l1, l2 = _lengths(lengths)
    s12, c12 = sin(q1 + q2), cos(q1 + q2)
    return np.array([[-l1 * sin(q1) - l2 * s12, -l2 * s12], [l1 * cos(q1) + l2 * c12, l2 * c12]])


def inverse(position: ArrayLike, lengths: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Return both configurations that put the tip at a position.

        q₂ = ±2 atan2(√((l₁ + l₂)² − r²), √(r² − (l₁ − l₂)²)),    r = ‖x‖
        q₁ = atan2(x₂, x₁) − atan2(l₂s₂, l₁ + l₂c₂)

    The half angle keeps the digits that arccos loses near the stretched arm. At the ends of the
    reach the two coincide (q₂ = 0, or ±π).

    Args:
        position: x (2,), m.
        lengths: l₁ and l₂, m.

    Returns:
        q (2, 2), rad: q[0] has q₂ ≥ 0, q[1] has q₂ ≤ 0.

    Raises:
        ValueError: the position is out of reach; it is the base, where q₁ is not determined; it is
            not (2,) and finite; a length is not positive.

    Source: Craig, as for `forward`.
    """
    x1, x2 = arguments.vector("position", position, 2).tolist()
    l1, l2 = _lengths(lengths)
    r, longest, shortest = hypot(x1, x2), l1 + l2, abs(l1 - l2)
    rounding = 8.0 * EPSILON * longest
    if not shortest - rounding <= r <= longest + rounding:
        raise ValueError(
            f"position is {r:.6g} m from the base, out of reach: "
            f"links of {l1:.6g} m and {l2:.6g} m reach from {shortest:.6g} m to {longest:.6g} m"
        )
    if r <= rounding:
        raise ValueError("position is the base, a singularity: every q₁ folds the arm onto it")
    to_longest = sqrt(max(0.0, (longest - r) * (longest + r)))
    to_shortest = sqrt(max(0.0, (r - shortest) * (r + shortest)))
    q2 = 2.0 * atan2(to_longest, to_shortest)
    heading, lead = atan2(x2, x1), atan2(l2 * sin(q2), l1 + l2 * cos(q2))
    return np.array([[heading - lead, q2], [heading + lead, -q2]])


def velocity(q: ArrayLike, xdot: ArrayLike, lengths: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Return the joint velocity of a velocity of the tip.

        v₁ = (c₁₂ẋ₁ + s₁₂ẋ₂) / (l₁s₂)
        v₂ = −((l₁c₁ + l₂c₁₂)ẋ₁ + (l₁s₁ + l₂s₁₂)ẋ₂) / (l₁l₂s₂)

    Args:
        q: joint angles (2,), rad.
        xdot: velocity of the tip ẋ (2,), m/s.
        lengths: l₁ and l₂, m.

    Returns:
        v (2,), rad/s.

    Raises:
        ValueError: the arm is stretched or folded, s₂ = 0; an argument is mis-shaped; a length is
            not positive.

    Source: Craig, as for `forward`.
    """
    q1, q2 = arguments.vector("q", q, 2).tolist()
    w1, w2 = arguments.vector("xdot", xdot, 2).tolist()
    l1, l2 = _lengths(lengths)
    s2, s12, c12 = sin(q2), sin(q1 + q2), cos(q1 + q2)
    if abs(s2) <= 4.0 * EPSILON:
        raise ValueError(f"q is singular: the arm is stretched or folded at q₂ = {q2:.6g} rad")
    along = c12 * w1 + s12 * w2
    radial = (l1 * cos(q1) + l2 * c12) * w1 + (l1 * sin(q1) + l2 * s12) * w2
    return np.array([along / (l1 * s2), -radial / (l1 * l2 * s2)])
