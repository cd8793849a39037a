"""Where a run starts: a keyframe, the configuration that is given, or qpos0 inside the ranges."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.joints import held_ranges, listed
from rmrc.limits.models import LimitsModel
from rmrc.model.configuration import (
    QPOS_WIDTH,
    joint_type,
    normalized,
    resolve_configuration,
)
from rmrc.model.frames import find, names
from rmrc.model.keyframes import HOME
from rmrc.model.scene import Scene

Array = NDArray[np.float64]
Start = str | Sequence[float] | Mapping[str, float] | None

_FOLLOWED = 10
"""Most joints in a row that each follow the one before."""


def start_keyframe(model: mujoco.MjModel, start: object) -> int | None:
    """Return the keyframe that a run starts in: the one it names, else `home`, else the only one.

    It gives all that the start does not say: coordinates, mocap poses and controls.

    Raises:
        ModelError: If the model has no such keyframe.
    """
    if isinstance(start, str):
        return find(model, "keyframe", start)
    if HOME in names(model, "keyframe"):
        return find(model, "keyframe", HOME)
    return 0 if model.nkey == 1 else None


def start_configuration(scene: Scene, start: Start, limits: LimitsModel) -> tuple[Array, list[str]]:
    """Return the configuration (nq,) that a run starts from, and what to say of it.

    Raises:
        ModelError: If the model has no such keyframe or joint.
        ValueError: If a list has the wrong length.
    """
    model, said = scene.model, []
    key = start_keyframe(model, None)
    if key is not None:
        base, where = model.key_qpos[key], model.key(key).name
        said.append(
            f"the start is the keyframe '{where}'" if where else "the start is the keyframe"
        )
    else:
        base, moved = _inside(model, scene.rest, held_ranges(model, limits))
        where = f", moved inside the ranges: {listed(model, moved)}" if moved else ""
        said.append(f"the start is qpos0{where}")
    q = normalized(model, resolve_configuration(model, start, base))
    return q, said if start is None else []


def place_mocap_bodies(model: mujoco.MjModel, start: object) -> None:
    """Have the model's mocap bodies where its start has them, and so every mjData made of it.

    Raises:
        ModelError: If the model has no such keyframe.
        ValueError: If a quaternion of its mocap bodies has zero norm.
    """
    if not model.nmocap:
        return
    key = start_keyframe(model, start)
    if key is None:
        return
    bodies = np.flatnonzero(model.body_mocapid >= 0)
    quaternions = model.key_mquat[key].reshape(-1, 4)
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        name = model.key(key).name
        raise ValueError(f"keyframe '{name}' turns a mocap body by a quaternion of zero norm")
    order = model.body_mocapid[bodies]
    model.body_pos[bodies] = model.key_mpos[key].reshape(-1, 3)[order]
    model.body_quat[bodies] = (quaternions / lengths)[order]


def _inside(model: mujoco.MjModel, q: Array, ranges: Array) -> tuple[Array, list[int]]:
    """Return q (nq,) with hinges and slides in their ranges and where the ones they follow say.

    Args:
        model: The model.
        q: A configuration.
        ranges: The range (njnt, 2) of each joint.
    """
    scalar = [j for j in range(model.njnt) if QPOS_WIDTH[joint_type(model, j)] == 1]
    at, moved = model.jnt_qposadr, q.copy()
    moved[at[scalar]] = np.clip(q[at[scalar]], *ranges[scalar].T)
    for _ in range(_FOLLOWED):
        before = moved.copy()
        for equality in np.flatnonzero(model.eq_active0).tolist():
            if model.eq_type[equality] == mujoco.mjtEq.mjEQ_JOINT:
                _follow(model, moved, ranges, equality)
        if (moved == before).all():
            break
    return moved, [j for j in scalar if moved[at[j]] != q[at[j]]]


def _follow(model: mujoco.MjModel, q: Array, ranges: Array, equality: int) -> None:
    """Put a joint where an equality y − y₀ = p(x − x₀) has it, x moved where y has no room."""
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    c, at, zero = model.eq_data[equality, :5], model.jnt_qposadr, model.qpos0
    y = at[follower]
    if leader < 0:
        q[y] = np.clip(zero[y] + c[0], *ranges[follower])
        return
    x = at[leader]
    wanted = zero[y] + np.polynomial.polynomial.polyval(q[x] - zero[x], c)
    q[y] = np.clip(wanted, *ranges[follower])
    if q[y] != wanted and c[1] and not c[2:].any():
        q[x] = np.clip(zero[x] + (q[y] - zero[y] - c[0]) / c[1], *ranges[leader])
