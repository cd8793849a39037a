"""What a brake leaves of a velocity: the robot stays on the line that it moves on."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def left_of(before: Array, change: Array) -> Array:
    """Return what a step of braking leaves of the velocity `before` (n,), rad/s or m/s.

    The joint that needs longest sheds its `change` = a_max dt (n,), the others in proportion to it,
    so that nobody exceeds a_max and the robot rests as soon as if each braked alone. What has no
    limit, of which `change` is infinite, rests at once.
    """
    steps = float((np.abs(before) / change).max())
    part = 1.0 - 1.0 / steps if steps > 1.0 else 0.0
    return np.where(np.isfinite(change), before * part, 0.0)
