"""End-effector speed: the norm of a frame's velocity, as rows of the program."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.frames import FrameHandle

Array = NDArray[np.float64]

FORWARD = 0.97
"""Largest share of the limit that the box of a velocity gives to one direction."""
_EVEN = 1.0 / math.sqrt(3.0)


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


class SpeedRows:
    """Rows |uᵢᵀ J v| ≤ bᵢ that keep ‖J v‖ ≤ V for the linear or the angular half of a frame.

    The three uᵢ are orthonormal and Σ bᵢ² = V², so that the box they make lies inside the ball.
    u₁ is the direction in which the task wants to move, and b₁ the speed that it asks for there,
    between V/√3 and 0.97 V: along the task's own direction almost all of V can be used.
    """

    def __init__(self, limit: FrameSpeed, data: mujoco.MjData, nv: int):
        self.limit = limit
        self._data = data
        self._rotation = limit.frame.views(data)[1]
        self._jacobian = np.zeros((6, nv))
        halves = ((slice(3), limit.linear), (slice(3, 6), limit.angular))
        self._halves = [(part, largest) for part, largest in halves if largest < math.inf]
        self.count = 3 * len(self._halves)

    def write(self, model: mujoco.MjModel, rate: Array, rows: Array, bound: Array) -> None:
        """Write uᵀJ (count, nv) and b (count,) for the task's ẋ (6,)."""
        jacobian = self._jacobian
        self.limit.frame.jacobian(
            model, self._data, jacobian[:3], jacobian[3:], self.limit.frame.id
        )
        for k, (part, largest) in enumerate(self._halves):
            wanted = rate[part]
            if self.limit.turned:
                wanted = self._rotation.reshape(3, 3) @ wanted
            asked = math.sqrt(wanted.dot(wanted))
            first = min(max(asked, _EVEN * largest), FORWARD * largest)
            at = slice(3 * k, 3 * k + 3)
            bound[at] = math.sqrt(0.5 * (largest**2 - first**2))
            bound[3 * k] = first
            rows[at] = _basis(wanted, asked) @ jacobian[part]


def _basis(direction: Array, length: float) -> Array:
    """Return an orthonormal basis (3, 3), by rows, whose first vector is along a direction."""
    if length < 1e-12:
        return np.eye(3)
    # A Householder reflection takes x̂ to the direction; its rows are the basis.
    u = direction / length
    mirror = u.copy()
    mirror[0] += math.copysign(1.0, u[0])
    return np.eye(3) - (2.0 / mirror.dot(mirror)) * np.outer(mirror, mirror)
