"""Configurations and joints of a MuJoCo model by name: keyframes, {joint: value}, dofs."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.frames import find

Array = NDArray[np.float64]

QPOS_WIDTH = {
    mujoco.mjtJoint.mjJNT_FREE: 7,
    mujoco.mjtJoint.mjJNT_BALL: 4,
    mujoco.mjtJoint.mjJNT_SLIDE: 1,
    mujoco.mjtJoint.mjJNT_HINGE: 1,
}
DOF_WIDTH = {
    mujoco.mjtJoint.mjJNT_FREE: 6,
    mujoco.mjtJoint.mjJNT_BALL: 3,
    mujoco.mjtJoint.mjJNT_SLIDE: 1,
    mujoco.mjtJoint.mjJNT_HINGE: 1,
}


def joint_type(model: mujoco.MjModel, joint: int) -> mujoco.mjtJoint:
    """Return the type of a joint by its id."""
    return mujoco.mjtJoint(int(model.jnt_type[joint]))


def joint_dofs(model: mujoco.MjModel, joint: int) -> NDArray[np.intp]:
    """Return the dofs of a joint by its id."""
    first = int(model.jnt_dofadr[joint])
    return np.arange(first, first + DOF_WIDTH[joint_type(model, joint)])


def dof_of_joint(model: mujoco.MjModel, name: str) -> NDArray[np.intp]:
    """Return the dofs of a joint by its name.

    Raises:
        ModelError: If the model has no such joint.
    """
    return joint_dofs(model, find(model, "joint", name))


def free_dofs(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the dofs of all floating bases."""
    free = [j for j in range(model.njnt) if joint_type(model, j) == mujoco.mjtJoint.mjJNT_FREE]
    return np.concatenate([joint_dofs(model, j) for j in free] or [np.zeros(0, dtype=np.intp)])


def turning_dofs(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which dofs turn, not shift (nv,)."""
    turning = np.ones(model.nv, dtype=np.bool_)
    for joint in range(model.njnt):
        kind, first = joint_type(model, joint), int(model.jnt_dofadr[joint])
        if kind == mujoco.mjtJoint.mjJNT_SLIDE:
            turning[first] = False
        elif kind == mujoco.mjtJoint.mjJNT_FREE:
            turning[first : first + 3] = False
    return turning


def resolve_configuration(
    model: mujoco.MjModel,
    value: str | Sequence[float] | Mapping[str, float] | None,
    base: Array,
) -> Array:
    """Return a configuration (nq,) from a keyframe's name, a list, or {joint: value} on a base.

    Raises:
        ModelError: If the model has no such keyframe or joint.
        ValueError: If the list's length is not nq, or a joint is not a hinge or a slide.
    """
    if value is None:
        return base.copy()
    if isinstance(value, str):
        return model.key_qpos[find(model, "keyframe", value)].copy()
    if not isinstance(value, Mapping):
        if len(value) != model.nq:
            raise ValueError(
                f"qpos of this model has {model.nq} numbers, and these are {len(value)}"
            )
        return normalized(model, np.array(value, dtype=float))
    q = base.copy()
    for name, coordinate in value.items():
        joint = find(model, "joint", name)
        if QPOS_WIDTH[joint_type(model, joint)] != 1:
            raise ValueError(f"joint '{name}' is no hinge or slide; give all of qpos as a list")
        q[model.jnt_qposadr[joint]] = coordinate
    return q


def normalized(model: mujoco.MjModel, q: Array) -> Array:
    """Return the configuration with its quaternions normalised.

    Raises:
        ValueError: If a quaternion has zero norm.
    """
    q = q.copy()
    for joint in range(model.njnt):
        width = QPOS_WIDTH[joint_type(model, joint)]
        if width > 1:
            last = int(model.jnt_qposadr[joint]) + width
            norm = float(np.linalg.norm(q[last - 4 : last]))
            if norm < 1e-12:
                raise ValueError("a quaternion of zero norm is no rotation")
            q[last - 4 : last] /= norm
    return q
