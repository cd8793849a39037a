"""Joint velocities inside a box: saturation in the null space, and damped least squares."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rmrc.reference import arguments, linear
from rmrc.reference.arguments import Array

# What passes a limit by less than this share of v is inside; so is a task slowed by less.
ROUNDING = 1e-12
# A joint this near to its limit, as a share of the larger of 1 and v, is at it.
NEAR = 1e-9
# A joint whose column of the remaining null space is shorter than this is held by the task.
HELD = 1e-9
# What ½‖v_N‖²/‖J⁺ẋ‖² weighs beside s, for the part v_N of v in the null space. What gains more of s
# is found exactly; a motion that gains less for its length is not worth it.
WORTH = 1e-6


class Saturation(NamedTuple):
    """What `saturate` finds: v, and what the limits did to it."""

    v: Array
    """Joint velocity (n,), rad/s."""
    scale: float
    """s, the share of the task's velocity that the limits admit."""
    multiplier: Array
    """z (n,), ≥ 0 at an upper limit and ≤ 0 at a lower one, 0 where the limits are not in the way.

    It is that of ½‖v‖² at this s, v + Jᵀλ + z = 0, in rad/s. To the limits that decide s, ∂s/∂limit
    in s/rad is added.
    """


def saturated(J: ArrayLike, xdot: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Array:
    """Return the least-norm joint velocity inside the limits, the task slowed as little as needed.

        min ½‖v‖²  subject to  Jv = sẋ,  lower ≤ v ≤ upper,  with the largest s ≤ 1 that admits one

    Where joints would have to rush in the null space to gain next to nothing of s, as where they
    have a part of 1e-9 in it, s is what s − ½ 10⁻⁶ ‖v_N‖²/‖J⁺ẋ‖² is largest for, with the part v_N
    of v in the null space; so v is continuous in J.

    It starts from v = sJ⁺ẋ, saturates the joint that passes its limit the furthest, lets the
    others make up for it in the null space, v = sJ⁺ẋ + N[:, W]μ for the saturated joints W, and
    releases a joint whose multiplier μ changes sign; so it ends at the optimum of this QP. When
    the joints in W leave no motion to make up with, they say how large s can be. Where ẋ is not in
    the range of J, its projection JJ⁺ẋ takes its place. s = ⟨ẋ, Jv⟩/⟨ẋ, JJ⁺ẋ⟩.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        lower: lower limits of v, a number or (n,), rad/s; −inf where there is none.
        upper: upper limits, in the same way.

    Returns:
        v (n,), rad/s, with lower ≤ v ≤ upper.

    Raises:
        ValueError: lower > upper; no v inside the limits has Jv = sẋ with 0 ≤ s ≤ 1, which takes
            limits that exclude v = 0; an argument is mis-shaped.

    Source: Flacco, De Luca and Khatib, Motion control of redundant robots under joint constraints:
    saturation in the null space, ICRA 2012, and Control of redundant robots under hard joint
    constraints: saturation in the null space, IEEE Transactions on Robotics 31(3), 2015 (the
    optimal variant). The active set: Goldfarb and Idnani, A numerically stable dual method for
    solving strictly convex quadratic programs, Mathematical Programming 27, 1983.
    """
    return saturate(J, xdot, lower, upper).v


def saturate(J: ArrayLike, xdot: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Saturation:
    """Return the velocity of `saturated`, the scale s, and the multipliers of the limits.

    The arguments and what is raised are those of `saturated`.
    """
    J, xdot = arguments.task(J, xdot)
    lower, upper = arguments.bounds(lower, upper, J.shape[1])
    U, sigma, V = linear.singular_values(J, None)
    free = V @ ((U.T @ xdot) / sigma)
    if (lower <= free).all() and (free <= upper).all():
        return Saturation(free, 1.0, np.zeros(free.size))
    k = linear.power(free)
    free, lower, upper = (np.ldexp(values, -k) for values in (free, lower, upper))
    null = np.linalg.qr(V, mode="complete").Q[:, V.shape[1] :]
    v, scale, multiplier, stop = _slowed(null, free, lower, upper)
    # What more of s is worth beyond what it costs; ∂s/∂limit takes it to the limits that decide s.
    gains = free.dot(free) / WORTH - (v + multiplier) @ free
    priced = multiplier + stop * gains
    # Positive at an upper limit, negative at a lower one, and zero between them.
    near = NEAR * np.maximum(1.0, np.abs(v))
    least = np.where(v >= upper - near, np.minimum(priced, 0.0), priced)
    wrong = np.abs(np.where(v <= lower + near, np.maximum(least, 0.0), least))
    limit = ROUNDING * max(1.0, float(np.abs(priced).max()))
    if wrong.max() > limit or (not stop.any() and gains < 0.0):
        v, scale, stop = _worthwhile(null, free, lower, upper)
        multiplier = np.zeros(free.size)
    return Saturation(np.ldexp(v, k), scale, np.ldexp(multiplier, k) + np.ldexp(stop, -k))


def _slowed(
    null: Array, free: Array, lower: Array, upper: Array
) -> tuple[Array, float, Array, Array]:
    """Return the least v (n,) for the largest s, s, the multipliers of ½‖v‖² and ∂s/∂limit."""
    working = _WorkingSet(null)
    scale, stop = 1.0, np.zeros(free.size)
    while True:
        v, normal = _nearest(working, scale * free, lower, upper)
        if normal is None:
            return v, scale, working.multiplier(), stop
        # No motion of the null space changes normalᵀv = s · normalᵀJ⁺ẋ; the box ends at `edge`.
        held = normal != 0.0
        edge = normal[held] @ np.where(normal > 0.0, upper, lower)[held]
        speed = normal @ free
        if edge < 0.0:
            raise ValueError("lower, upper: no v inside them has J v = s xdot with 0 ≤ s ≤ 1")
        stop = normal / speed
        if edge >= (1.0 - ROUNDING) * scale * speed:
            return v, scale, working.multiplier(), stop
        scale = float(edge / speed)


def _worthwhile(null: Array, free: Array, lower: Array, upper: Array) -> tuple[Array, float, Array]:
    """Return v (n,) and s for which ½‖v_N‖² − ‖J⁺ẋ‖² s/10⁻⁶ is least, and what limits are worth.

    With t = s ‖J⁺ẋ‖ as one more joint it is the point of a box nearest to (J⁺ẋ/‖J⁺ẋ‖, 1) T, along
    that direction and the null space.
    """
    n, speed = free.size, float(np.sqrt(free.dot(free)))
    far = speed / (2.0 * WORTH)
    along = np.append(free / speed, 1.0)
    basis = np.zeros((n + 1, null.shape[1] + 1))
    basis[:, 0], basis[:n, 1:] = along / np.sqrt(2.0), null
    working = _WorkingSet(basis)
    v, normal = _nearest(working, far * along, np.append(lower, 0.0), np.append(upper, speed))
    if normal is not None:
        raise ValueError("lower, upper: no v inside them has J v = s xdot with 0 ≤ s ≤ 1")
    worth = working.multiplier()[:n] * WORTH / speed**2
    return v[:n], float(v[n] / speed), worth


def bounded_dls(
    J: ArrayLike, xdot: ArrayLike, lower: ArrayLike, upper: ArrayLike, damping: float
) -> Array:
    """Return the damped least-squares joint velocity inside the limits.

        min ½‖Jv − ẋ‖² + ½λ²‖v‖²  subject to  lower ≤ v ≤ upper

    It is the quadratic program of one task in the box of the joints. Unlike `saturated` it trades
    the direction of ẋ. With w = (ẋ − Jv)/λ it is the least norm of (v, w) for Jv + λw = ẋ, where
    w has no limits.

    Args:
        J: Jacobian (m, n), rows in m/rad or rad/rad.
        xdot: task velocity ẋ (m,), m/s or rad/s.
        lower: lower limits of v, a number or (n,), rad/s; −inf where there is none.
        upper: upper limits, in the same way.
        damping: λ, at least 1e-8 ‖J‖, in the units of J.

    Returns:
        v (n,), rad/s, with lower ≤ v ≤ upper.

    Raises:
        ValueError: lower > upper; the damping is less than 1e-8 ‖J‖; an argument is mis-shaped.

    Source: the QP of `saturated` with a slack.
    """
    J, xdot = arguments.task(J, xdot)
    rows, columns = J.shape
    lower, upper = arguments.bounds(lower, upper, columns)
    damping = arguments.positive("damping", damping)
    least = 10.0 * HELD * np.linalg.norm(J)
    if damping < least:
        raise ValueError(f"damping = {damping:.3g} is too small for this J: at least {least:.3g}")
    none = np.full(rows, np.inf)
    slack = np.hstack((J, damping * np.eye(rows)))
    U, sigma, V = linear.singular_values(slack, None)
    free = V @ ((U.T @ xdot) / sigma)
    k = linear.power(free)
    ends = np.append(lower, -none), np.append(upper, none)
    null = np.linalg.qr(V, mode="complete").Q[:, V.shape[1] :]
    v = _slowed(null, *(np.ldexp(values, -k) for values in (free, *ends)))[0]
    return np.ldexp(v, k)[:columns]


def _nearest(
    working: "_WorkingSet", free: Array, lower: Array, upper: Array
) -> tuple[Array, Array | None]:
    """Return the v nearest to `free` in the box, over v − free in the range of N.

    If there is no such v, return one in the box and a normal a with Na = 0 and aᵀfree > aᵀw for
    all w in the box. Each pass of the dual active-set method pushes the joint that is furthest
    outside back in; `working` may hold joints from another `free` to begin with.
    """
    working.review(free)
    distance = -1.0
    while True:
        move = working.hold(free)
        v = free + move
        v[working.joints] = working.limits
        excess = np.maximum(lower - v, v - upper)
        j = int(excess.argmax())
        inside = np.minimum(np.maximum(v, lower), upper)
        moved = move.dot(move)
        # Each pass takes v further from `free`; one that does not was rounding.
        if excess[j] <= ROUNDING * max(1.0, abs(v[j])) or moved <= distance:
            return inside, None
        distance = moved
        normal = working.push(j, 1.0 if v[j] < lower[j] else -1.0, inside[j], excess[j])
        if normal is not None:
            return inside, normal


class _WorkingSet:
    """The joints W that are held at limits: v = free + Nμ, with μ = 0 outside W."""

    def __init__(self, Z: Array) -> None:
        """Hold no joint; the columns of Z are an orthonormal basis of the null space, N = ZZᵀ."""
        self.joints: list[int] = []
        self._sides: list[float] = []  # +1 at a lower limit, −1 at an upper
        self.limits: list[float] = []
        self._sizes: list[float] = []  # |μ|
        self._Z = Z
        self._Q, self._R_inverse = np.eye(Z.shape[1]), np.zeros((0, 0))

    def _factorize(self) -> None:
        # Z[W]ᵀ = QR: the motions that move W, and in the other columns of Q those that do not.
        self._Q, R = np.linalg.qr(self._Z[self.joints].T, mode="complete")
        self._R_inverse = np.linalg.inv(R[: len(self.joints)])

    def _release(self, index: int) -> None:
        for column in (self.joints, self._sides, self.limits, self._sizes):
            del column[index]
        self._factorize()

    def hold(self, free: Array) -> Array:
        """Return the least motion Nμ that takes the joints W to their limits, and keep |μ|."""
        pull = (self.limits - free[self.joints]) @ self._R_inverse
        self._sizes = (self._sides * (self._R_inverse @ pull)).tolist()
        return self._Z @ (self._Q[:, : pull.size] @ pull)

    def multiplier(self) -> Array:
        """Return −μ (n,), which is the multiplier z of v + Jᵀλ + z = 0."""
        z = np.zeros(len(self._Z))
        z[self.joints] = -np.multiply(self._sides, self._sizes)
        return z

    def review(self, free: Array) -> None:
        """Release the joints that would have to be pulled to their limits, not pushed."""
        self.hold(free)
        while min(self._sizes, default=0.0) < 0.0:
            self._release(self._sizes.index(min(self._sizes)))
            self.hold(free)

    def push(self, j: int, side: float, limit: float, gap: float) -> Array | None:
        """Take joint j into W, releasing the joints whose |μ| falls to zero before its gap closes.

        If the joints of W leave it no motion, return the normal of the limits that stop it.
        """
        while True:
            held = len(self.joints)
            row = self._Z[j] @ self._Q
            response = (self._R_inverse @ row[:held]).tolist()
            give = row[held:] @ row[held:]
            time, released = (gap / give if give > HELD**2 else np.inf), -1
            falls = [side * own * change for own, change in zip(self._sides, response, strict=True)]
            for i, (size, fall) in enumerate(zip(self._sizes, falls, strict=True)):
                if fall > ROUNDING and size < time * fall:
                    time, released = size / fall, i
            if time == np.inf:
                normal = np.zeros(len(self._Z))
                normal[self.joints], normal[j] = np.multiply(side, response), -side
                return normal
            if released < 0:
                self.joints.append(j)
                self._sides.append(side)
                self.limits.append(limit)
                self._factorize()
                return None
            gap -= time * give
            self._sizes = [s - time * fall for s, fall in zip(self._sizes, falls, strict=True)]
            self._release(released)
