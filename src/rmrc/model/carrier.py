"""What a moving mocap body does to the points that it carries."""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Carrier(NamedTuple):
    """A mocap body that a body is part of, or that a robot stands on."""

    origin: Array
    """Where it is (3,), a view."""
    twist: Array
    """Its linear and angular velocity in the world (6,), a view."""

    def velocity(self, point: Array) -> Array:
        """Return the velocity v + ω × (p − o), ω (6,) of what it carries at a point (3,)."""
        carried = self.twist.copy()
        carried[:3] += np.cross(self.twist[3:], point - self.origin)
        return carried


def carrier_of(
    model: mujoco.MjModel, data: mujoco.MjData, twists: Array, body: int
) -> Carrier | None:
    """Return the mocap body that carries a body, if there is one, with its row of the twists."""
    mocap = int(model.body_mocapid[model.body_rootid[body]])
    return None if mocap < 0 else Carrier(data.mocap_pos[mocap], twists[mocap])


def carry_on(later: mujoco.MjData, now: mujoco.MjData, twists: Array, dt: float) -> None:
    """Put the mocap bodies of `later` where those of `now` are dt seconds on.

    Args:
        later: What is written.
        now: What is read.
        twists: Velocities of the mocap bodies (nmocap, 6).
        dt: s.
    """
    later.mocap_pos[:], later.mocap_quat[:] = now.mocap_pos + twists[:, :3] * dt, now.mocap_quat
    for quaternion, rate in zip(later.mocap_quat, twists[:, 3:], strict=True):
        # mju_quatIntegrate turns by a rate in the body's own axes, and this is the world's.
        local, inverse = np.empty(3), np.empty(4)
        mujoco.mju_negQuat(inverse, quaternion)
        mujoco.mju_rotVecQuat(local, rate, inverse)
        mujoco.mju_quatIntegrate(quaternion, local, dt)
