"""Pairs of geoms that no configuration keeps apart, as neighbours in a chain often are."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.limits.distance import is_capsule_and_box, signed_distance

Array = NDArray[np.float64]

CONFIGURATIONS = 64
"""Configurations that are looked at; a pair that can keep its distance does so in some of them."""
TURN = 3.0
"""Half the range in rad, or m, that a joint without one is taken to have."""


def always_near(model: mujoco.MjModel, pairs: NDArray[np.intp], d_min: float) -> NDArray[np.bool_]:
    """Return which pairs (p, 2) are nearer than d_min in all of some random configurations (p,)."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    looked_at = [(a, b, is_capsule_and_box(model, a, b)) for a, b in pairs.tolist()]
    near, segment = np.arange(len(pairs)), np.empty(6)
    for _ in range(CONFIGURATIONS):
        data.qpos = _random_configuration(model, rng)
        mujoco.mj_kinematics(model, data)
        distances = [signed_distance(model, data, looked_at[k], d_min, segment) for k in near]
        near = near[np.array(distances) < d_min]
        if not near.size:
            break
    found = np.zeros(len(pairs), dtype=np.bool_)
    found[near] = True
    return found


def _random_configuration(model: mujoco.MjModel, rng: np.random.Generator) -> Array:
    """Return hinges and slides anywhere in their ranges, and the others anywhere near."""
    q = model.qpos0.copy()
    mujoco.mj_integratePos(model, q, rng.uniform(-TURN, TURN, model.nv), 1.0)
    limited = np.flatnonzero(model.jnt_limited)
    scalar = limited[model.jnt_type[limited] >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
    q[model.jnt_qposadr[scalar]] = rng.uniform(*model.jnt_range[scalar].T)
    return q
