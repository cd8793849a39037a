"""Position inverse kinematics by gradient descent, and the clamping of its targets."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from numpy.typing import ArrayLike

from rmrc.reference import arguments
from rmrc.reference.arguments import Array
from rmrc.reference.linear import EPSILON

# Armijo: the share of the decrease that the slope promises which a step has to deliver.
SUFFICIENT = 1e-4


def clamp(dx: ArrayLike, limit: float) -> Array:
    """Return dx shortened to a length, dx · min(1, limit/‖dx‖).

    Args:
        dx: a displacement, an error or a velocity (m,).
        limit: the largest length > 0, in the units of dx; infinity for none.

    Returns:
        dx (m,), ‖dx‖ ≤ limit.

    Raises:
        ValueError: dx is not a finite vector; the limit is not positive.

    Source: Buss and Kim 2005 (clamping the distance of target positions).
    """
    dx = arguments.vector("dx", dx)
    if not limit > 0.0:
        raise ValueError(f"limit is {limit}; it must be > 0")
    length = sqrt(dx.dot(dx))
    return dx * (limit / length) if length > limit else dx.copy()


@dataclass(frozen=True, slots=True)
class Descent:
    """The result of `descent`."""

    q: Array
    """The last configuration (n,), rad."""
    iterations: int
    """Steps taken."""
    error: float
    """‖x − f(q)‖, m or rad."""
    converged: bool
    """The error is within the tolerance. If not, the iterations ran out or no step helps."""


def descent(
    x: ArrayLike,
    q: ArrayLike,
    f: Callable[[Array], ArrayLike],
    jacobian: Callable[[Array], ArrayLike],
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
) -> Descent:
    """Return a configuration that reaches a position, by gradient descent on ½‖x − f(q)‖².

        q ← q + α Jᵀe,   e = x − f(q)

    α starts at the optimal step of `transpose`, ‖Jᵀe‖²/‖JJᵀe‖², and is halved until the error
    falls enough (Armijo): ½‖e‖² falls with every step.

    Args:
        x: target (m,), m or rad.
        q: configuration to start from (n,), rad.
        f: forward kinematics, (n,) → (m,).
        jacobian: of f, (n,) → (m, n).
        tolerance: error at which to stop, in the units of x.
        max_iterations: the most steps to take.

    Returns:
        The `Descent`: q, iterations, error, converged.

    Raises:
        ValueError: an argument, or what f or jacobian return, is mis-shaped or not finite; the
            tolerance is negative.

    Source: the method: Wolovich and Elliott 1984; the line search: Armijo, Minimization of
    functions having Lipschitz continuous first partial derivatives, Pacific Journal of
    Mathematics 16(1), 1966.
    """
    x = arguments.vector("x", x)
    q = arguments.vector("q", q).copy()
    tolerance = arguments.nonnegative("tolerance", tolerance)
    error = x - arguments.vector("f(q)", f(q), x.size)
    iterations = 0
    while True:
        length = sqrt(error.dot(error))
        if length <= tolerance or iterations >= max_iterations:
            return Descent(q, iterations, length, length <= tolerance)
        J = arguments.matrix("jacobian(q)", jacobian(q))
        if J.shape != (x.size, q.size):
            raise ValueError(f"jacobian(q) has shape {J.shape}; it must be ({x.size}, {q.size})")
        lower = _line_search(x, q, f, J, error)
        if lower is None:
            return Descent(q, iterations, length, False)
        q, error = lower
        iterations += 1


def _line_search(
    x: Array, q: Array, f: Callable[[Array], ArrayLike], J: Array, error: Array
) -> tuple[Array, Array] | None:
    """Return a configuration of less error, and that error; None where no step along Jᵀe helps."""
    direction = J.T @ error
    slope = sqrt(direction.dot(direction))
    if not slope:
        return None
    direction /= slope
    moved = J @ direction
    curvature = moved.dot(moved)
    squared = error.dot(error)
    step = slope / curvature if curvature else 0.0
    # Below ε‖e‖² a decrease is rounding.
    while step * slope > EPSILON * squared:
        trial = q + step * direction
        nearer = x - arguments.vector("f(q)", f(trial), x.size)
        if nearer.dot(nearer) <= squared - 2.0 * SUFFICIENT * step * slope:
            return trial, nearer
        step *= 0.5
    return None
