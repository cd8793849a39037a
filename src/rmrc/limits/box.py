"""The limits of the joints, from position to jerk: one box in velocity, never empty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmrc.limits.jerk import JerkLimit

Array = NDArray[np.float64]

# A joint this little outside its range is on it: rounding, not a violation. rad or m.
RANGE_ROUNDING = 1e-9
# Steps to rest, in place of none.
TINY = 1e-300


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
    jerk: Array
    """j_max, rad/s³ or m/s³."""
    step: Array
    """Most that a joint moves in a step, rad or m, whatever its other limits are."""


def braking(
    box: Box, v: Array, dt: float, q: Array | None = None, *, ahead: float = 0.0
) -> tuple[Array, Array]:
    """Return the steps of dt that v (n,) takes to rest, and by how much |v| falls in each.

    All joints brake in the proportions of v, so that the robot stays on the line that it moves on
    and nears nothing that it moves along; the joint that takes longest brakes at its a_max. A joint
    whose range ends before brakes as hard as it must, by v²/(2 r + v dt) with the way r that is
    left then, which is the same at every later step.

    Args:
        box: The limits.
        v: The velocity (n,).
        dt: Length of a step, s.
        q: Where the joints are (nq,), or else none has a range.
        ahead: How long they still go on with v from there before they brake, s.
    """
    speed, most = np.abs(v), box.acceleration * dt
    limited = np.isfinite(most)
    change = np.where(limited, speed / max((speed / most).max(initial=0.0), TINY), most)
    if q is not None:
        way = np.where(v > 0.0, box.upper - q[box.coordinate], q[box.coordinate] - box.lower)
        way = 2.0 * (way - speed * ahead) + speed * dt
        needed = np.divide(speed * speed * dt, way, out=most.copy(), where=way > 0.0)
        change = np.maximum(change, np.minimum(needed, most))
    return np.divide(speed, change, out=np.zeros_like(speed), where=speed > 0.0), change


def braked(box: Box, v: Array, dt: float, q: Array) -> Array:
    """Return what is left of v (n,), which has led to q (nq,), after a step of braking.

    As `BoxLimit` has it, a joint stays able to stop in its range whatever the next steps last.
    """
    _, change = braking(box, v, dt, q)
    room = np.where(v > 0.0, box.upper - q[box.coordinate], q[box.coordinate] - box.lower)
    stops = (room >= 0.0) & np.isfinite(room) & np.isfinite(box.acceleration)
    speed, most = np.abs(v[stops]), box.acceleration[stops] * dt
    shed = speed - stopping_speed(room[stops], box.acceleration[stops], dt)
    change[stops] = np.maximum(change[stops], np.minimum(shed, most))
    return v - np.clip(v, -change, change)


def stopping_speed(room: Array, acceleration: Array, dt: float) -> Array:
    """Return √(a²dt² + 2a r) − a dt for the room r ≥ 0, so that it is exact for a small one."""
    change, reach = acceleration * dt, 2.0 * acceleration * room
    return reach / (np.sqrt(change * change + reach) + change)


class BoxLimit:
    """Computes the box lb ≤ v ≤ ub of a step.

    Position asks for g(q_min − q)/dt ≤ v ≤ g(q_max − q)/dt and, with an acceleration limit a, that
    the joint can still stop: v ≤ −a dt + √(a²dt² + 2a(q_max − q)), mirrored below. The jerk limit
    gives the first interval (see `JerkLimit`), and position, velocity and acceleration, in this
    order, each clip both its ends into their own; velocity to no more than `step`/dt. Clipping
    keeps the order of the ends, so that lb ≤ ub whatever the limits say to each other, and the last
    of them wins.

    A joint with v²/2a ≤ q_max − q stays in its range, whatever the lengths of the steps: a v with
    v dt + v²/2a ≤ q_max − q leaves that true after the step, and v_prev − a dt, or rest where it
    is less than a step away, always is such a v.
    """

    def __init__(self, box: Box):
        n = box.lower.size
        self._coordinate = np.stack([box.coordinate] * 2)
        self._range = np.stack([box.lower, box.upper])
        self._ranged = bool(np.isfinite(self._range).any())
        self._gain = box.gain
        self._rate, self._rate_dt = np.empty((2, n)), 0.0
        # Both ends stand in one array, so that each limit is one call over 2n numbers.
        self._velocity, self._step = np.stack([box.velocity] * 2), box.step
        self._fastest, self._slowest = np.empty((2, 2, n))
        self._ends = np.empty((2, n))
        self.lower, self.upper = self._ends
        """lb and ub (n,) of the last update, rad/s or m/s."""
        self._room, self._product = np.empty((2, n)), np.empty(n)
        self._below, self._above = self._room
        self._outward = np.array([[-1.0], [1.0]])
        limited = np.isfinite(box.acceleration)
        self._acceleration = box.acceleration if limited.any() else None
        self._stopping = np.nonzero(limited & np.isfinite(self._range))
        self._deceleration = box.acceleration[self._stopping[1]]
        self._stop = np.full((2, n), np.inf)
        self._jerked = np.flatnonzero(np.isfinite(box.jerk))
        self._jerk = None
        if self._jerked.size:
            jerk, acceleration, velocity = (
                values[self._jerked] for values in (box.jerk, box.acceleration, box.velocity)
            )
            self._jerk = JerkLimit(jerk, acceleration, velocity, box.gain)

    def update(self, q: Array, v_previous: Array, a_previous: Array, dt: float) -> bool:
        """Compute the bounds at q (nq,) after a step with the velocity and acceleration (n,).

        Return whether a joint is outside its range.
        """
        ends, room = self._ends, self._room
        outside = False
        np.subtract(self._range, q[self._coordinate], out=room)
        if self._ranged:
            # The ends have the same sign where q is not between them.
            np.multiply(self._below, self._above, out=self._product)
            if np.maximum.reduce(self._product) > 0.0:
                outside = self._is_outside()
        if dt != self._rate_dt:
            self._rate.fill(self._gain / dt)
            np.minimum(self._velocity, self._step / dt, out=self._fastest)
            np.negative(self._fastest, out=self._slowest)
            self._rate_dt = dt
        np.multiply(room, self._rate, out=ends)
        if self._deceleration.size:
            self._make_stoppable(dt)
        if self._jerk is not None:
            some = self._jerked
            outward = (self._outward * room)[:, some]
            eased = self._jerk.bounds(outward, v_previous[some], a_previous[some], dt)
            ends[:, some] = np.clip(eased, self.lower[some], self.upper[some])
        np.maximum(ends, self._slowest, out=ends)
        np.minimum(ends, self._fastest, out=ends)
        if self._acceleration is not None:
            change = self._acceleration * dt
            np.maximum(ends, v_previous - change, out=ends)
            np.minimum(ends, v_previous + change, out=ends)
        return outside

    def _is_outside(self) -> bool:
        rounding = RANGE_ROUNDING
        return bool((self._below > rounding).any() or (self._above < -rounding).any())

    def _make_stoppable(self, dt: float) -> None:
        """Clip the ends into the velocities from which each joint can stop in the room it has.

        A joint outside its range on that side has no room to stop in: the position limit alone says
        how fast it comes back.
        """
        ends, a = self._ends, self._deceleration
        room = (self._outward * self._room)[self._stopping]
        speed = stopping_speed(np.maximum(room, 0.0), a, dt)
        self._stop[self._stopping] = np.where(room >= 0.0, speed, np.inf)
        np.maximum(ends, -self._stop[0], out=ends)
        np.minimum(ends, self._stop[1], out=ends)
