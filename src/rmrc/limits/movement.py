"""How far geoms have moved since poses of reference, at most."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.extents import extents

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


class Movement:
    """How far the geoms have moved since poses of reference, at most."""

    def __init__(self, model: mujoco.MjModel, geoms: Ids):
        self._position, self._quaternion = np.zeros((model.nbody, 3)), np.zeros((model.nbody, 4))
        self._seen_position = np.full((model.nbody, 3), np.nan)
        self._seen_quaternion = np.full((model.nbody, 4), np.nan)
        self._shift, self._turn = np.zeros((model.nbody, 3)), np.zeros((model.nbody, 4))
        reach = np.zeros(model.nbody)
        np.maximum.at(reach, model.geom_bodyid[geoms], extents(model)[geoms])
        # A rotation moves a point at the distance ρ by at most 2ρ times the quaternion's change.
        self._reach = 2.0 * reach
        self._lever = np.repeat(self._reach[:, None], 4, axis=1)

    def arrays(self) -> dict[str, Array]:
        """Return the reach of the bodies' geoms, twice, and the poses that are remembered."""
        return {
            "reach": self._reach,
            "position": self._position,
            "quaternion": self._quaternion,
            "seen_position": self._seen_position,
            "seen_quaternion": self._seen_quaternion,
        }

    def bound(self, data: mujoco.MjData) -> float:
        """Return how much nearer two geoms can have come to each other, at most."""
        shift, turn = self._shift, self._turn
        np.subtract(data.xpos, self._position, out=shift)
        np.subtract(data.xquat, self._quaternion, out=turn)
        np.multiply(turn, self._lever, out=turn)
        # The sum of two of the bodies' motions is at most √2 times the norm of all.
        return 1.4143 * float(np.sqrt(np.vdot(shift, shift)) + np.sqrt(np.vdot(turn, turn)))

    def moved(self) -> Array:
        """Return how far each body's geoms moved (nbody,), up to the poses of the last `bound`."""
        moved = np.sqrt(np.einsum("ij,ij->i", self._shift, self._shift))
        moved += np.sqrt(np.einsum("ij,ij->i", self._turn, self._turn))
        return moved

    def restart(self, data: mujoco.MjData) -> None:
        """Make the poses of now those of reference."""
        self._position[:], self._quaternion[:] = data.xpos, data.xquat

    def since_seen(self, data: mujoco.MjData) -> bool:
        """Return whether the poses are others than at the last call."""
        position, quaternion = self._seen_position, self._seen_quaternion
        if (data.xpos == position).all() and (data.xquat == quaternion).all():
            return False
        position[:], quaternion[:] = data.xpos, data.xquat
        return True
