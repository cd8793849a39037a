"""Whether joints shake: their accelerations change sign at every step, for a while.

Nothing is promised where limits contradict each other (RECOVERING, RELAXED), nor with steps of
more than 0.1 s.
"""

import numpy as np

from soaking.drawer import Array

STEPS, SECONDS = 10, 0.1
"""A window: so many steps, and so much time."""
MOVES = 1e-3
"""rad/s or m/s; what is slower does not shake."""
ROUNDING = 1e-9
"""A smaller change of a rate is rounding, rad/s or m/s: by 1e-16 at a bound of 0.27 rad/s."""
LONGEST = 0.1
"""s: with longer steps nothing is promised."""


class Shaking:
    """Counts, for each joint, the steps in a row in which its acceleration changes sign."""

    def __init__(self, dofs: int):
        self._rate, self._change = np.zeros((2, dofs))
        self._steps, self._seconds = np.zeros(dofs, dtype=int), np.zeros(dofs)

    def forget(self) -> None:
        """Begin anew: something moved the robot, or what it is after."""
        self._change[:] = 0.0
        self._steps[:] = 0
        self._seconds[:] = 0.0

    def update(self, v: Array, dt: float) -> float:
        """Take note of a command (n,); return 1 where a joint has shaken for a window, else 0."""
        change = v - self._rate
        change[np.abs(change) < ROUNDING] = 0.0
        turns = (change * self._change < 0.0) & (np.abs(v) > MOVES)
        self._steps = np.where(turns, self._steps + 1, 0)
        self._seconds = np.where(turns, self._seconds + dt, 0.0)
        self._rate[:], self._change[:] = v, change
        shaken = (self._steps >= STEPS) & (self._seconds >= SECONDS)
        return float(dt <= LONGEST and shaken.any())
