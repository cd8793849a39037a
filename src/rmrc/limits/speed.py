"""End-effector speed: the norm of a frame's velocity, as rows of the program."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.frames import FrameHandle

Array = NDArray[np.float64]

PLANES = 12
"""Planes that may stand for the ball of one half of a frame's velocity."""
INSIDE = 1e-4
"""Share of the limit that the planes are inside the ball by: so much of it is left unused at most,
and the optimum of the planes is inside the ball once one of them is within 0.8° of it."""
STILL = 1e-12
"""A shorter velocity has no direction, m/s or rad/s."""


@dataclass(frozen=True, eq=False)
class FrameSpeed:
    """The largest speed of a task's frame."""

    task: str
    frame: FrameHandle
    turned: bool
    """Whether the task's ẋ is along the frame's own axes, not the world's."""
    linear: float
    """m/s; infinite without a limit."""
    angular: float
    """rad/s; infinite without a limit."""


class _Ball:
    """‖J v‖ ≤ V for one half of a frame's velocity, J (3, nv), by planes and by their curvature."""

    def __init__(self, jacobian: Array, largest: float, half: str):
        self.jacobian, self.largest, self.half = jacobian, largest, half
        self._used, self._bent = 0, False
        self._directions, self._direction = np.zeros((PLANES, 3)), np.zeros(3)
        self.curvature = 0.0
        """μ = y/ρ, what the multiplier y of a ball of radius ρ bends the cost by across u."""

    def begin(self, directions: tuple[Array, ...], rows: Array, upper: Array) -> None:
        """Have the planes of these directions, and no others, in rows (PLANES, nv) and hi."""
        rows[:], upper[:] = 0.0, math.inf
        self._used, self.curvature, self._bent = 0, 0.0, False
        for direction in directions:
            self._add(direction, rows, upper)

    def velocity(self, v: Array) -> tuple[Array, float]:
        """Return J v (3,) and its length."""
        moved = self.jacobian @ v
        return moved, math.sqrt(moved.dot(moved))

    def cut(self, v: Array, y: Array | None, rows: Array, upper: Array) -> bool:
        """Change rows or curvature where v (nv,) is none for the ball; return whether.

        With the multipliers y (PLANES,) of the rows, the curvature may be changed as well.
        """
        moved, length = self.velocity(v)
        multiplier = 0.0 if y is None else float(y.sum())
        unbent = multiplier > 0.0 and not self._bent
        if length <= self.largest and not unbent:
            idle = self.curvature > 0.0 and not multiplier > 0.0
            if idle:  # no ball is in the way, and so no curvature of it
                self.curvature = 0.0
            return idle
        self.curvature = max(multiplier, 0.0) / ((1.0 - INSIDE) * self.largest)
        if unbent and y is not None:
            self._bent = True
            self._direction = self._directions[int(y.argmax())].copy()
            return True
        return self._add(moved, rows, upper)

    def _add(self, direction: Array, rows: Array, upper: Array) -> bool:
        length = math.sqrt(direction.dot(direction))
        if not length > STILL or self._used == PLANES:
            return False
        self._direction = direction / length
        self._directions[self._used] = self._direction
        rows[self._used] = self._direction @ self.jacobian
        upper[self._used] = (1.0 - INSIDE) * self.largest
        self._used += 1
        return True

    def bend(self) -> Array:
        """Return μ Jᵀ(I − uuᵀ)J (nv, nv), which no v along u has a part in."""
        along = self._direction @ self.jacobian
        return self.curvature * (self.jacobian.T @ self.jacobian - np.outer(along, along))


class SpeedRows:
    """Rows uᵀ J v ≤ ρ that keep ‖J v‖ ≤ V for the linear and the angular half of a frame.

    Each is a plane that touches a ball of ρ = (1 − 10⁻⁴) V. The first two touch it where the last
    command moves the frame to, and where the task wants it to go. Where one of them binds, the
    program is solved again with the curvature of the ball, μ = y/ρ across u for the multiplier y of
    the planes: without it the optimum lies anywhere on the plane inside V, and the command shakes
    along it. Where the optimum passes V all the same, a further plane along J v follows with its
    curvature, until it is inside: Newton's method (sequential quadratic programming) on outer
    planes (Kelley 1960). Where J v is along u the curvature has no part in the optimum, which is
    that of the ball. A plane that is not there is a row of zeros without a limit.
    """

    def __init__(self, limit: FrameSpeed, data: mujoco.MjData, nv: int):
        self.limit = limit
        self._data = data
        self._rotation = limit.frame.views(data)[1]
        self._jacobian = np.zeros((6, nv))
        halves = ((slice(3), limit.linear, "linear"), (slice(3, 6), limit.angular, "angular"))
        self._balls = [
            (part, _Ball(self._jacobian[part], largest, name))
            for part, largest, name in halves
            if largest < math.inf
        ]
        self.count = PLANES * len(self._balls)

    def write(
        self, model: mujoco.MjModel, v_previous: Array, rate: Array, rows: Array, upper: Array
    ) -> None:
        """Write uᵀJ (count, nv) and hi (count,) for the last v (nv,) and the task's ẋ (6,)."""
        jacobian = self._jacobian
        self.limit.frame.jacobian(
            model, self._data, jacobian[:3], jacobian[3:], self.limit.frame.id
        )
        for k, (part, ball) in enumerate(self._balls):
            wanted = rate[part]
            if self.limit.turned:
                wanted = self._rotation.reshape(3, 3) @ wanted
            its = slice(PLANES * k, PLANES * (k + 1))
            ball.begin((ball.velocity(v_previous)[0], wanted), rows[its], upper[its])

    def cut(self, v: Array, y: Array | None, rows: Array, upper: Array) -> bool:
        """Change rows (count, nv), hi (count,) or curvature where v (nv,) is too fast.

        Return whether anything has changed. Curvature is changed with the multipliers y (count,).
        """
        changed = False
        for k, (_, ball) in enumerate(self._balls):
            its = slice(PLANES * k, PLANES * (k + 1))
            changed |= ball.cut(v, None if y is None else y[its], rows[its], upper[its])
        return changed

    def bends(self) -> list[Array]:
        """Return what the curvatures add to the cost, each (nv, nv)."""
        return [ball.bend() for _, ball in self._balls if ball.curvature > 0.0]

    def excess(self, v: Array) -> float:
        """Return by how much v (nv,) moves the frame too fast, at most, in m/s or rad/s."""
        return max((ball.velocity(v)[1] - ball.largest for _, ball in self._balls), default=0.0)

    def share(self, brake: Array, v: Array) -> float:
        """Return the largest s ≤ 1 for which b + s (v − b) is no faster than the frame may be.

        0 where the brake b (nv,) is as fast itself.
        """
        most = 1.0
        for _, ball in self._balls:
            start, way = ball.jacobian @ brake, ball.jacobian @ (v - brake)
            # ‖start + s way‖² = V²
            room = ball.largest**2 - start.dot(start)
            if room <= 0.0:
                return 0.0
            square, along = way.dot(way), start.dot(way)
            if square > 0.0:
                root = math.sqrt(along**2 + square * room)
                most = min(most, room / (along + root) if along + root > 0.0 else 1.0)
        return most

    def half_of(self, row: int) -> tuple[str, float]:
        """Return the name and the limit of the half that a row belongs to."""
        _, ball = self._balls[row // PLANES]
        return ball.half, ball.largest
