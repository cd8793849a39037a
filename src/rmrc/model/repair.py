"""What keeps a spec from compiling and has nothing to do with kinematics is repaired."""

import re
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.meshes import Assets

Array = NDArray[np.float64]

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6
"""kg and kg m², of a body that moves and has none."""
MOST_REPAIRS = 1000
"""Compilations of one scene, each after a repair."""

_ELEMENT = re.compile(r"Element name '([^']*)'")


class Repairs:
    """Compiles a spec; where MuJoCo refuses what kinematics does not need, repairs it."""

    def __init__(self, assets: Assets):
        self._assets = assets
        self._inertias: dict[str, None] = {}
        self._keys: dict[str, None] = {}
        self._balanced = False
        self._weighed: set[str] = set()
        self._shells: set[str] = set()

    def compile(self) -> mujoco.MjModel:
        """Return the compiled model.

        Raises:
            ValueError: What MuJoCo says of what cannot be repaired.
        """
        for _ in range(MOST_REPAIRS):
            try:
                return self._assets.spec.compile()
            except ValueError as error:
                self._assets.spec = self._assets.spec.copy()  # the error sticks to the other
                if not self._repaired(str(error)):
                    raise
        raise ValueError(f"more than {MOST_REPAIRS} repairs are needed")

    def notices(self) -> list[str]:
        """Return what was repaired."""
        said = []
        if self._inertias:
            said.append(
                "masses or inertias that no body can have were repaired, which kinematics does not "
                f"need and physics does: {', '.join(list(self._inertias)[:6])}"
                + (f" and {len(self._inertias) - 6} more" if len(self._inertias) > 6 else "")
            )
        if self._keys:
            said.append(
                f"keyframes that do not fit the model are left out: {', '.join(self._keys)}"
            )
        return said

    def _repaired(self, message: str) -> bool:
        named = _ELEMENT.search(message)
        name = named[1] if named else ""
        if "inertia must satisfy" in message or "fullinertia" in message:
            return self._balance()
        if "mass and inertia of moving bodies" in message:
            return self._weigh(name)
        if "keyframe" in message or re.search(
            r"invalid (qpos|qvel|ctrl|act|mpos|mquat) size", message
        ):
            return self._drop_key(name)
        mesh = self._mesh(message, name)
        return mesh is not None and self._mend_mesh(mesh, message)

    def _balance(self) -> bool:
        """Give every body an inertia that a body can have."""
        if self._balanced:
            return False
        self._balanced = True
        for body in self._assets.spec.bodies:
            if not body.explicitinertial:
                continue
            full = np.array(body.fullinertia, dtype=float)
            matrix = np.diag(np.array(body.inertia, dtype=float))
            if np.isfinite(full).all():
                matrix = _symmetric(full)
            moments, axes = np.linalg.eigh(matrix)
            possible = _possible(moments)
            if not np.allclose(possible, moments, rtol=1e-9, atol=0.0):
                self._inertias[body.name] = None
                self._set_inertia(body, axes, possible)
        return bool(self._inertias)

    def _set_inertia(self, body: Any, axes: Array, moments: Array) -> None:
        matrix = axes @ np.diag(moments) @ axes.T
        if np.isfinite(np.array(body.fullinertia)).all():
            body.fullinertia = [*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]]
        else:
            body.inertia = np.diag(matrix)

    def _weigh(self, name: str) -> bool:
        """Give bodies that move and have no mass, or no inertia, a little."""
        found: list[str] = []
        for body in self._assets.spec.bodies:
            light = body.explicitinertial and (
                body.mass < LEAST_INERTIA or not _inertia_of(body).any()
            )
            empty = not body.explicitinertial and not list(body.geoms)
            moves = bool(list(body.joints))
            if body.name not in self._weighed and (
                (body.name == name) or (moves and not self._weighed and (light or empty))
            ):
                found.append(body.name)
                self._inertias[body.name] = None
                body.explicitinertial = True
                body.mass = max(float(body.mass) if np.isfinite(body.mass) else 0.0, LEAST_MASS)
                body.fullinertia = [np.nan, *[0.0] * 5]
                body.inertia = np.maximum(np.nan_to_num(np.array(body.inertia)), LEAST_INERTIA)
                if not np.isfinite(np.array(body.ipos)).all():
                    body.ipos = np.zeros(3)
        self._weighed.update(found)
        return bool(found)

    def _drop_key(self, name: str) -> bool:
        """Leave a keyframe out that does not fit the model."""
        for key in list(self._assets.spec.keys):
            if key.name == name:
                self._keys[name or "(without a name)"] = None
                self._assets.spec.delete(key)
                return True
        return False

    def _mesh(self, message: str, name: str) -> Any | None:
        """Return the mesh that a message is about, if it is about one."""
        if not re.search(r"mesh|face|vert|volume|file|STL|OBJ|normal|qhull", message):
            return None
        quoted = re.findall(r"'([^']*)'", message)
        for mesh in self._assets.spec.meshes:
            if (mesh.name and mesh.name == name) or (mesh.file and mesh.file in quoted):
                return mesh
        for mesh in self._assets.spec.meshes:
            if mesh.name and mesh.name in quoted:
                return mesh
        return None

    def _mend_mesh(self, mesh: Any, message: str) -> bool:
        """Count a mesh's inertia from its surface where it has no volume, else leave it out."""
        about_volume = re.search(r"volume|orient|inertia|watertight", message)
        if about_volume and mesh.name not in self._shells:
            self._shells.add(mesh.name)
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        else:
            self._assets.leave_out(mesh, "MuJoCo cannot read it")
        return True


def _symmetric(full: Array) -> Array:
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _inertia_of(body: Any) -> Array:
    full = np.array(body.fullinertia, dtype=float)
    return full if np.isfinite(full).all() else np.array(body.inertia, dtype=float)


def _possible(moments: Array) -> Array:
    """Return moments of inertia (3,) that a body can have: positive, none above the others' sum.

    Those that are too small are raised.
    """
    low = max(LEAST_INERTIA * float(np.abs(moments).max()), 1e-12)
    a, b, c = np.sort(np.maximum(moments, low))
    if a + b < c:  # as MuJoCo's own balanceinertia does: the mean of the three
        a = b = c = (a + b + c) / 3.0
    order = np.argsort(np.maximum(moments, low))
    result = np.empty(3)
    result[order] = a, b, c
    return result


def name_all(spec: mujoco.MjSpec) -> None:
    """Give the bodies and joints that have no name one that can be used."""
    bodies = {body.name for body in spec.bodies}
    for number, body in enumerate(depth_first(spec)):
        if not body.name:
            body.name = _free(f"body{number}", bodies)
    joints = {joint.name for joint in spec.joints}
    for body in depth_first(spec):
        for joint in body.joints:
            if not joint.name:
                joint.name = _free(f"{body.name}_joint", joints)


def depth_first(spec: mujoco.MjSpec) -> Iterator[Any]:
    """Yield the bodies in the order that they are compiled in, the world first."""
    waiting = [spec.worldbody]
    while waiting:
        body = waiting.pop()
        yield body
        waiting += reversed(list(body.bodies))


def _free(name: str, taken: set[str]) -> str:
    candidate, count = name, 1
    while candidate in taken:
        count += 1
        candidate = f"{name}{count}"
    taken.add(candidate)
    return candidate
