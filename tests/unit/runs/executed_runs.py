"""What the tests of runs in the physics share."""

import mujoco
import numpy as np

# Two ways of computing a force or an acceleration: rounding alone.
ROUNDING = 1e-9

JOINT_CONTROLS = ["torque", "position"]


def moving(model: mujoco.MjModel, seed: int) -> tuple[mujoco.MjData, np.ndarray, np.ndarray]:
    """Return a random state in motion, and set points near it with their velocities."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    data.qpos[:] = rng.uniform(low, high)
    data.qvel[:] = rng.normal(size=model.nv)
    return data, data.qpos + 0.01 * rng.normal(size=model.nq), rng.normal(size=model.nv)
