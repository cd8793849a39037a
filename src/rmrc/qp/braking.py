"""Braking in time: what drives the errors is no faster than the joints can shed on the way left."""

import numpy as np
from numpy.typing import NDArray

from rmrc.limits.box import Box

Array = NDArray[np.float64]

STEADY = 0.37
"""c j/a² with which the field's jerk, at most 4/27 a²/c, is two fifths of the limit."""
EASED = 0.4
"""Share of the jerk limit that the field v(δ) may ask for."""
TRACKED = 0.6
"""Share of the jerk limit with which the joints come to the field's speed: what is left."""


class Braking:
    """Slows down what drives the errors, so that no joint overshoots where it has limits to shed.

    With v the optimum without limits, feed-forward apart, and δ = |H⁻¹ Σ JᵀB e| the way that is
    left to each joint (n,), the speed from which it can stop within acceleration a and jerk j is

        top = √(c² + 2 a δ) − c,  c = max(½ a dt, 0.37 a²/j, a/K − 0.4 j/K²),

    a field on which a joint decelerates by a v/(v + c), so that the jerk stays below 0.4 j, where
    it goes over into the linear decay K = v/δ, too; a is no more than (j² δ)^⅓, what the jerk lets
    it become on the way. s = min(1, min top/|v|) keeps the direction, and r = s v is followed.

    With a jerk limit the acceleration must have come to that of the field when the speed has:
    a joint at v_prev = r − d takes no more than −κ r ± √(2 · 0.6 j |d|), with κ the field's slope.
    """

    def __init__(self, box: Box):
        self.brakes = bool(np.isfinite(box.acceleration).any() or np.isfinite(box.jerk).any())
        """Whether any joint has something to shed its rate with."""
        self._jerks = bool(np.isfinite(box.jerk).any())
        self._box = box

    def field(self, v: Array, way: Array, gain: float, dt: float) -> tuple[float, Array]:
        """Return s and the slope κ (n,) of the field at v (n,).

        Args:
            v: The optimum without limits (n,).
            way: H⁻¹ Σ JᵀB e (n,).
            gain: The largest gain.
            dt: Length of the step, s.
        """
        speed = np.abs(v)
        left = np.maximum(np.abs(way), speed / gain)
        moving = speed > 0.0
        decay = np.divide(speed, left, out=np.full_like(speed, gain), where=moving)
        jerk, a = self._box.jerk, self._box.acceleration
        a = np.minimum(a, np.cbrt(jerk * jerk * np.where(moving, left, 1.0)))
        with np.errstate(invalid="ignore"):  # without limits ∞ − ∞
            eased = np.maximum(STEADY * a * a / jerk, a / decay - EASED * jerk / decay**2)
            c = np.maximum(0.5 * a * dt, np.where(np.isfinite(jerk), eased, 0.0))
            top = 2.0 * a * left / (np.sqrt(c * c + 2.0 * a * left) + c)
        share = np.divide(
            top, speed, out=np.full_like(speed, np.inf), where=moving & ~np.isnan(top)
        )
        slowest = int(share.argmin())
        if not share[slowest] < 1.0:
            return 1.0, decay
        return float(share[slowest]), np.full_like(decay, a[slowest] / (top[slowest] + c[slowest]))

    def followed(self, r: Array, slope: Array, v_previous: Array, dt: float) -> Array:
        """Return the velocity (n,) that comes to r (n,) inside the jerk limits."""
        box = self._box
        r = np.clip(r, -box.velocity, box.velocity)
        change = TRACKED * box.jerk * dt
        missing = r - v_previous
        with np.errstate(invalid="ignore"):
            approach = (
                np.sqrt(change * change + 2.0 * TRACKED * box.jerk * np.abs(missing)) - change
            )
        rate = np.clip(-slope * r, -box.acceleration, box.acceleration)
        rate += np.copysign(np.where(np.isfinite(box.jerk), approach, np.inf), missing)
        direct = missing / dt
        return v_previous + dt * np.where(
            missing >= 0.0, np.minimum(direct, rate), np.maximum(direct, rate)
        )

    @property
    def jerks(self) -> bool:
        """Whether any joint has a jerk limit."""
        return self._jerks
