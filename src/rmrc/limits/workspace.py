"""Workspace bounds: the origins of frames stay in front of planes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError
from rmrc.limits.barrier import Barrier, Near
from rmrc.limits.models import WorkspacePlane
from rmrc.model.extents import body_levers
from rmrc.model.frames import FrameHandle, resolve
from rmrc.text.mistakes import Mistake

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

WAY_BACK = 0.1
"""Largest speed in m/s at which a plane that is passed asks its frame back."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane that a frame's origin p stays in front of: nᵀp ≥ offset."""

    frame: FrameHandle
    label: str
    """What a message calls it."""
    normal: Array
    """n (3,), of unit length, in the world."""
    offset: float
    """m."""


@dataclass(frozen=True, eq=False)
class WorkspacePlanes:
    """The planes of a problem that share a gain."""

    planes: tuple[Plane, ...]
    gain: float
    """Share of the free distance that a step may use."""
    push: float
    """Largest speed of the way back from outside, m/s."""

    def build(self, model: mujoco.MjModel, obstacle_twist: Array) -> "Workspace":
        """Return the barrier; `obstacle_twist` are the velocities of the mocap bodies."""
        return Workspace(model, self, obstacle_twist)


def compile_workspace(
    model: mujoco.MjModel,
    limits: Sequence[WorkspacePlane],
    dofs: NDArray[np.intp],
    mistakes: list[Mistake],
) -> list[WorkspacePlanes]:
    """Return the planes of a configuration, those with the same gain together.

    Args:
        model: The model.
        limits: The configuration's planes.
        dofs: The dofs that may move.
        mistakes: Where to add what does not fit the model.
    """
    planes: dict[float, list[Plane]] = {}
    for index, limit in enumerate(limits):
        try:
            frame = resolve(model, limit.frame)
        except ModelError as unknown:
            mistakes.append(Mistake(("limits", "workspace", index, "frame"), str(unknown)))
            continue
        if not levers(model, frame)[dofs].any():
            message = f"no joint that may move moves the {frame.kind} '{limit.frame.name}'"
            mistakes.append(Mistake(("limits", "workspace", index, "frame"), message))
        normal = np.array(limit.normal) / np.linalg.norm(limit.normal)
        label = f"{frame.kind} '{limit.frame.name}' and plane {index + 1}"
        planes.setdefault(limit.gain, []).append(Plane(frame, label, normal, limit.offset))
    return [WorkspacePlanes(tuple(alike), gain, WAY_BACK) for gain, alike in planes.items()]


class Workspace(Barrier):
    """h = nᵀp − offset with ∂h/∂q = nᵀJ_p; ∂h/∂t is nᵀv of a robot that stands on a mocap body.

    All planes always have their row: with acceleration limits one may bind long before a step can
    bring the frame to it.
    """

    kind: ClassVar[str] = "workspace"
    unit: ClassVar[str] = "m"

    def __init__(self, model: mujoco.MjModel, spec: WorkspacePlanes, obstacle_twist: Array):
        self.gain, self.push = spec.gain, spec.push
        self._model, self.planes, self._twist = model, spec.planes, obstacle_twist
        self.size, self._ids = len(spec.planes), np.arange(len(spec.planes))
        self._normal = np.array([plane.normal for plane in spec.planes])
        self._offset = np.array([plane.offset for plane in spec.planes])
        self._jacobian = np.zeros((3, model.nv))
        bodies = [_body(model, plane.frame)[0] for plane in spec.planes]
        self._mocap = model.body_mocapid[model.body_rootid[bodies]]
        self.levers = np.array([levers(model, plane.frame) for plane in spec.planes])

    def near(self, data: mujoco.MjData, travel: Array, dt: float) -> Near:
        """Return all planes."""
        slope = np.empty((self._ids.size, self._model.nv))
        for plane, row in zip(self.planes, slope, strict=True):
            plane.frame.jacobian(self._model, data, self._jacobian, None, plane.frame.id)
            plane.normal.dot(self._jacobian, row)
        position = self._positions(data)
        return Near(self._ids, self._distances(position), slope, self._drift(data, position))

    def distances(self, data: mujoco.MjData, ids: Ids) -> Array:
        """Return h of some planes (k,)."""
        return self._distances(self._positions(data))[ids]

    def reach(self, ids: Ids, step: Array, dt: float) -> Array:
        """Return the sum of the levers' motions, more than which no chain can move its frame."""
        motion = np.concatenate([np.abs(step), np.abs(self._twist).ravel() * dt])
        return self.levers[ids] @ motion

    def name(self, identity: int) -> str:
        """Return the plane's label."""
        return self.planes[identity].label

    def least(self, data: mujoco.MjData) -> tuple[float, int]:
        """Return the least h and the plane's place in the list."""
        distances = self._distances(self._positions(data))
        least = int(np.argmin(distances))
        return float(distances[least]), least

    def _positions(self, data: mujoco.MjData) -> Array:
        return np.array([plane.frame.views(data)[0] for plane in self.planes])

    def _distances(self, position: Array) -> Array:
        return np.einsum("ij,ij->i", self._normal, position) - self._offset

    def _drift(self, data: mujoco.MjData, position: Array) -> Array:
        drift = np.zeros(self._ids.size)
        for k, mocap in enumerate(self._mocap.tolist()):
            if mocap >= 0:
                linear, angular = self._twist[mocap, :3], self._twist[mocap, 3:]
                arm = position[k] - data.mocap_pos[mocap]
                drift[k] = self._normal[k] @ (linear + np.cross(angular, arm))
        return drift


def levers(model: mujoco.MjModel, frame: FrameHandle) -> Array:
    """Return how fast each dof can move a frame's origin (nv + 6 nmocap,), as `body_levers`."""
    return body_levers(model, *_body(model, frame))


def _body(model: mujoco.MjModel, frame: FrameHandle) -> tuple[int, float]:
    """Return the body that a frame is fixed to, and the distance of their origins in m."""
    positions = {"site": model.site_pos, "geom": model.geom_pos}
    if frame.kind == "body":
        return frame.id, 0.0
    return frame.body(model), float(np.linalg.norm(positions[frame.kind][frame.id]))
