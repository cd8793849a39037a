"""Frames of a MuJoCo model, resolved once: ids, views of their poses, their Jacobian function."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.model.lie import pose_of
from rmrc.text.base import FRAME_KINDS, Frame, Subtree
from rmrc.text.source import FrameKind

Array = NDArray[np.float64]

OBJECTS: dict[str, mujoco.mjtObj] = {
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "keyframe": mujoco.mjtObj.mjOBJ_KEY,
    "equality": mujoco.mjtObj.mjOBJ_EQUALITY,
}
_COUNTS = {
    "site": "nsite",
    "body": "nbody",
    "geom": "ngeom",
    "joint": "njnt",
    "keyframe": "nkey",
    "equality": "neq",
}
_JACOBIANS: dict[str, Callable[..., None]] = {
    "site": mujoco.mj_jacSite,
    "body": mujoco.mj_jacBody,
    "geom": mujoco.mj_jacGeom,
}
_POSES = {
    "site": ("site_xpos", "site_xmat"),
    "body": ("xpos", "xmat"),
    "geom": ("geom_xpos", "geom_xmat"),
}


def names(model: mujoco.MjModel, kind: str) -> list[str]:
    """Return the names that the model has of one kind, unnamed things left out.

    A `mocap body` is one that is moved from outside.
    """
    if kind == "mocap body":
        bodies = np.flatnonzero(model.body_mocapid >= 0)
        return [name for body in bodies.tolist() if (name := model.body(body).name)]
    count = getattr(model, _COUNTS[kind])
    found = (mujoco.mj_id2name(model, OBJECTS[kind], i) for i in range(count))
    return [name for name in found if name]


def find(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Return the id of a named thing.

    Raises:
        ModelError: If the model has no such name; the message lists those it has.
    """
    i = mujoco.mj_name2id(model, OBJECTS[kind], name)
    if i < 0:
        raise ModelError(unknown_name(kind, name, names(model, kind)))
    return i


def in_subtree(model: mujoco.MjModel, part: Subtree) -> NDArray[np.bool_]:
    """Return which bodies are a body or hang on it (nbody,).

    Raises:
        ModelError: If the model has no such body.
    """
    inside = np.zeros(model.nbody, dtype=np.bool_)
    first = find(model, "body", part.subtree)
    for body in range(first, model.nbody):  # a parent comes before its children
        inside[body] = body == first or inside[model.body_parentid[body]]
    return inside


@dataclass(frozen=True)
class FrameHandle:
    """A site, body or geom of a model by its id."""

    kind: FrameKind
    id: int

    @property
    def jacobian(self) -> Callable[..., None]:
        """MuJoCo's function (model, data, jacp, jacr, id) for the world-axes Jacobian."""
        return _JACOBIANS[self.kind]

    def views(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return views of the frame's position (3,) and rotation matrix (9,) in the data."""
        position, matrix = _POSES[self.kind]
        return getattr(data, position)[self.id], getattr(data, matrix)[self.id]

    def body(self, model: mujoco.MjModel) -> int:
        """Return the body that the frame is fixed to."""
        owners = {"site": model.site_bodyid, "geom": model.geom_bodyid}
        return self.id if self.kind == "body" else int(owners[self.kind][self.id])

    def velocities(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return the velocities of its origin and its angular ones (3, nv), in the world's axes."""
        linear, angular = np.zeros((2, 3, model.nv))
        self.jacobian(model, data, linear, angular, self.id)
        return linear, angular

    def dofs(self, model: mujoco.MjModel) -> list[int]:
        """Return the dofs that move it, from the world to it."""
        return dofs_before(model, self.body(model))

    def pose_at(self, model: mujoco.MjModel, q: Array) -> Array:
        """Return the frame's pose (7,), wxyz + xyz, at a configuration (nq,)."""
        data = mujoco.MjData(model)
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        position, matrix = self.views(data)
        return np.array(pose_of(matrix, position))


def dofs_before(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the dofs that move a body, from the world to it."""
    found: list[int] = []
    while body:
        first = int(model.body_dofadr[body])
        found = [*range(first, first + int(model.body_dofnum[body])), *found]
        body = int(model.body_parentid[body])
    return found


def resolve(model: mujoco.MjModel, frame: Frame) -> FrameHandle:
    """Return the handle of a frame named in a configuration.

    Raises:
        ModelError: If the model has no such frame.
    """
    kind = frame.kind or _kind_of(model, frame.name)
    place = find(model, kind, frame.name)
    if frame.displaced is not None:
        return FrameHandle("site", find(model, "site", frame.displaced.name))
    return FrameHandle(kind, place)


def _kind_of(model: mujoco.MjModel, name: str) -> FrameKind:
    """Return whether a name is a site's, a body's or a geom's.

    Raises:
        ModelError: If there is none of that name, or more than one.
    """
    kinds: list[FrameKind] = [
        kind for kind in FRAME_KINDS if mujoco.mj_name2id(model, OBJECTS[kind], name) >= 0
    ]
    if len(kinds) > 1:
        choices = " or ".join(f"{{{kind}: {name}}}" for kind in kinds)
        raise ModelError(f"'{name}' is the name of a {' and of a '.join(kinds)}: say {choices}")
    if not kinds:
        known = [known for kind in FRAME_KINDS for known in names(model, kind)]
        raise ModelError(unknown_name("site, body or geom", name, dict.fromkeys(known)))
    return kinds[0]
