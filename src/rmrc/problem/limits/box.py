"""Position, velocity and acceleration limits of the joints: one box in velocity, never empty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A joint this little outside its range is on it: rounding, not a violation. rad or m.
RANGE_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Box:
    """The joint limits of a problem, one entry a dof; infinite where there is none."""

    coordinate: NDArray[np.intp]
    """Address in qpos of each dof's coordinate; any address where the dof has no range."""
    lower: Array
    """q_min + margin, rad or m."""
    upper: Array
    """q_max − margin, rad or m."""
    gain: float
    """Share g of the remaining distance that a step may use."""
    velocity: Array
    """v_max, rad/s or m/s."""
    acceleration: Array
    """a_max, rad/s² or m/s²."""


class BoxLimit:
    """Computes the box lb ≤ v ≤ ub of a step.

    Position asks for g(q_min − q)/dt ≤ v ≤ g(q_max − q)/dt and, with an acceleration limit a, that
    the joint can still stop: v ≤ −a dt + √(a²dt² + 2a(q_max − q)), mirrored below. Each limit of a
    higher order (stopping, velocity, acceleration) clips both ends into its own interval. Clipping
    keeps their order, so that lb ≤ ub whatever the limits say to each other.
    """

    def __init__(self, box: Box):
        n = box.lower.shape[0]
        self._coordinate = box.coordinate
        self._range = np.stack([box.lower, box.upper])
        self._sign = np.array([[-1.0], [1.0]])
        self._gain = box.gain
        self._ranged = bool(np.isfinite(self._range).any())
        self._velocity = box.velocity
        self._fastest = -box.velocity
        self._acceleration = box.acceleration if np.isfinite(box.acceleration).any() else None
        # Where there is no acceleration limit, the stopping distance must stay out of ∞ − ∞.
        self._braking = np.where(np.isfinite(box.acceleration), box.acceleration, 0.0)
        self._unbraked = ~np.isfinite(box.acceleration)
        self.bounds = np.empty((2, n))
        """lb and ub of the last call (2, n)."""

    def update(self, q: Array, v_previous: Array, dt: float) -> bool:
        """Compute the bounds at q (nq,) after v_previous (n,).

        Return whether a joint is outside its range.
        """
        bounds = self.bounds
        outside = False
        if self._ranged:
            np.subtract(self._range, q[self._coordinate], out=bounds)
            bounds *= self._sign  # the room left on each side, negative when outside
            outside = bool(np.minimum.reduce(bounds, axis=None) < -RANGE_ROUNDING)
            stop = self._stopping(dt) if self._acceleration is not None else None
            bounds *= self._gain / dt
            np.negative(bounds[0], out=bounds[0])
            if stop is not None:
                np.maximum(bounds, -stop[0], out=bounds)
                np.minimum(bounds, stop[1], out=bounds)
        else:
            bounds[0], bounds[1] = -np.inf, np.inf
        np.maximum(bounds, self._fastest, out=bounds)
        np.minimum(bounds, self._velocity, out=bounds)
        if self._acceleration is not None:
            change = self._acceleration * dt
            np.maximum(bounds, v_previous - change, out=bounds)
            np.minimum(bounds, v_previous + change, out=bounds)
        return outside

    def _stopping(self, dt: float) -> Array:
        """Return the speeds (2, n) from which each joint can stop in the room it has left."""
        step = self._braking * dt
        with np.errstate(invalid="ignore"):
            speed = np.sqrt(step**2 + 2.0 * self._braking * np.maximum(self.bounds, 0.0)) - step
        # No room at all: out of the range, the position limit alone says how fast to come back.
        speed[:, self._unbraked] = np.inf
        return np.where(self.bounds < 0.0, np.inf, speed)
