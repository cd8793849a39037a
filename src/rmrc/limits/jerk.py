"""Jerk limits: the box on the change of acceleration, entered early enough to be kept."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Stands for the room of a joint without a range: finite, so that differences of it are numbers.
FAR = 1e12


class JerkLimit:
    """Computes the velocities that keep |a − a_prev| ≤ j dt, for joints that have such a limit.

    Within that interval the ends are drawn in, so that neither the velocity limit nor the range
    will ask for more jerk later on: with a' = (v' − v)/dt
    - a' ≤ −j dt + √(j²dt² + 2j(v_max − v)), from where a' falls to 0 before v_max, and
    - v' dt/g + D(v', a') ≤ q_max − q, where D is the least way in which a joint stops,
    both mirrored below. D is the length of the profile that takes the acceleration down to −A,
    A ≤ a_max, and back to 0 as v comes to 0 (the second half of a double S: Biagiotti and
    Melchiorri, *Trajectory planning for automatic machines and robots*, 2008, section 3.4). D is
    convex, and a step at the lower end of the interval is no longer than what D falls by, at any
    dt: a joint that starts with room for D keeps all its limits. Only with a small g, below ½, may
    the position limit ask for more, since it draws the approach out further than D does.
    """

    def __init__(self, jerk: Array, acceleration: Array, velocity: Array, gain: float):
        # Of the operands' own shape, (3, 2, m): numpy takes half the time without broadcasting.
        self._jerk, self._acceleration, self._velocity = (
            np.tile(values, (3, 2, 1)) for values in (jerk, acceleration, velocity)
        )
        self._gain = gain

    def bounds(self, room: Array, v: Array, a: Array, dt: float) -> Array:
        """Return the least and the largest velocity of each joint (2, m).

        Args:
            room: q − q_min and q_max − q (2, m), rad or m.
            v: Velocities of the step before (m,).
            a: Accelerations of the step before (m,).
            dt: Length of the step, s.
        """
        # The lower end is the upper one of the mirrored joint.
        speed, rate = np.array([-v, v]), np.array([-a, a])
        jerk, limit, fastest = self._jerk[0], self._acceleration[0], self._velocity[0]
        change = jerk * dt
        least = np.minimum(np.maximum(rate - change, -limit), limit)
        below = np.maximum(fastest - speed, 0.0)
        approach = np.sqrt(change * change + 2.0 * jerk * below) - change
        most = np.maximum(np.minimum(np.minimum(rate + change, approach), limit), least)
        # The margin is concave in a': where it changes sign, its chord crosses 0 on the safe side.
        rest = np.minimum(np.maximum(-speed / dt, least), most)
        rates = np.array([least, rest, most])
        speeds = speed + rates * dt
        margin = np.minimum(room, FAR) - speeds * (dt / self._gain) - self._way(speeds, rates)
        stops = margin[1] >= 0.0
        inner, outer = np.where(stops, rates[1:], rates[:2])
        kept, missed = np.where(stops, margin[1:], margin[:2])
        kept = np.maximum(kept, 0.0)
        share = np.divide(kept, kept - missed, out=np.ones_like(kept), where=missed < 0.0)
        ends = speed + (inner + share * (outer - inner)) * dt
        ends[0] *= -1.0
        if (ends[0] > ends[1]).any():  # too little room on both sides
            ends[:] = np.where(ends[0] > ends[1], ends.mean(axis=0), ends)
        return ends

    def _way(self, v: Array, a: Array) -> Array:
        """Return D(v, a) ≥ 0, the least way in which a joint stops.

        From the peak v₀ = v + a²/2j, where a = 0, it takes ½v₀(v₀/A + A/j) with the strongest
        deceleration A = min(√(j v₀), a_max); reaching the peak, or having left it, adds
        va/j + a³/3j². A joint that brakes so hard that it would come back, a² > 2jv with a < 0,
        counts as one on a² = 2jv, which takes (√2/3) √(v³/j).
        """
        jerk = self._jerk
        gained = a * a / (2.0 * jerk)
        peak = np.maximum(v + gained, 0.0)
        strongest = np.minimum(np.sqrt(jerk * peak), self._acceleration)
        time = np.divide(peak, strongest, out=np.zeros_like(peak), where=strongest > 0.0)
        way = 0.5 * peak * (time + strongest / jerk) + a * (v + gained * (2.0 / 3.0)) / jerk
        ahead = np.maximum(v, 0.0)
        returning = np.sqrt(ahead**3 * (2.0 / 9.0) / jerk)
        return np.maximum(np.where((a < 0.0) & (gained > v), returning, way), 0.0)
