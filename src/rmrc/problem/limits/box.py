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
        n = box.lower.size
        # Both ends stand in one vector [lb; ub], so that each limit is one call over 2n numbers.
        self._coordinate = np.tile(box.coordinate, 2)
        self._range = np.concatenate([box.lower, box.upper])
        self._ranged = bool(np.isfinite(self._range).any())
        self._gain = box.gain
        self._rate = np.empty(2 * n)
        self._rate_dt = 0.0
        self._fastest = np.tile(box.velocity, 2)
        self._slowest = -self._fastest
        self._stops = box.acceleration if np.isfinite(box.acceleration).any() else None
        self._bounds = np.empty(2 * n)
        self._product = np.empty(n)
        self.lower, self.upper = self._bounds[:n], self._bounds[n:]
        """lb and ub (n,) of the last update, rad/s or m/s."""

    def update(self, q: Array, v_previous: Array, dt: float) -> bool:
        """Compute the bounds at q (nq,) after v_previous (n,).

        Return whether a joint is outside its range.
        """
        bounds, outside = self._bounds, False
        if self._ranged:
            if dt != self._rate_dt:
                self._rate.fill(self._gain / dt)
                self._rate_dt = dt
            np.subtract(self._range, q[self._coordinate], out=bounds)
            # The ends have the same sign where q is not between them.
            np.multiply(self.lower, self.upper, out=self._product)
            if np.maximum.reduce(self._product) > 0.0:
                outside = self._is_outside()
            stop = None if self._stops is None else self._stopping(self._stops, dt)
            np.multiply(bounds, self._rate, out=bounds)
            if stop is not None:
                np.maximum(bounds, stop[0], out=bounds)
                np.minimum(bounds, stop[1], out=bounds)
        else:
            self.lower.fill(-np.inf)
            self.upper.fill(np.inf)
        np.maximum(bounds, self._slowest, out=bounds)
        np.minimum(bounds, self._fastest, out=bounds)
        if self._stops is not None:
            change = self._stops * dt
            np.maximum(bounds, np.tile(v_previous - change, 2), out=bounds)
            np.minimum(bounds, np.tile(v_previous + change, 2), out=bounds)
        return outside

    def _is_outside(self) -> bool:
        rounding = RANGE_ROUNDING
        return bool((self.lower > rounding).any() or (self.upper < -rounding).any())

    def _stopping(self, acceleration: Array, dt: float) -> tuple[Array, Array]:
        """Return the velocities (2n,) from which each joint can still stop in the room it has.

        √(a²dt² + 2a r) − a dt for the room r, written so that it is exact for a small one. A joint
        outside its range on that side has no room to stop in: the position limit alone says how
        fast it comes back.
        """
        limited = np.where(np.isfinite(acceleration), acceleration, 0.0)
        step = limited * dt
        speeds = []
        for room in (-self.lower, self.upper):
            reach = 2.0 * limited * np.where(np.isfinite(room), np.maximum(room, 0.0), 0.0)
            root = np.sqrt(step**2 + reach) + step
            speed = np.divide(reach, root, out=np.zeros_like(root), where=root > 0.0)
            bound = np.isfinite(acceleration) & np.isfinite(room) & (room >= 0.0)
            speeds.append(np.where(bound, speed, np.inf))
        return np.tile(-speeds[0], 2), np.tile(speeds[1], 2)
