"""Ranges of tendons: their lengths stay within what the model says."""

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.barrier import Barrier, Near
from rmrc.limits.models import LimitsModel
from rmrc.model.extents import body_levers

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_WRAP = mujoco.mjtWrap


@dataclass(frozen=True, eq=False)
class TendonRanges:
    """The ranges of a problem's tendons: each has an entry for its lower and for its upper end."""

    tendons: Ids
    """The tendons (k,)."""
    sign: Array
    """1 for a lower end, −1 for an upper one (k,)."""
    bound: Array
    """Where the length L may go: h = sign · (L − bound) (k,)."""
    levers: Array
    """How fast each dof can change the length (k, nv), at most."""
    gain: float
    """Share of the remaining length that a step may use."""
    fixed: bool
    """Whether all are sums of joint coordinates, without a path in space."""

    def build(self, model: mujoco.MjModel, obstacle_twist: Array) -> "TendonRange":
        """Return the barrier; nothing but the joints themselves moves it."""
        return TendonRange(model, self)


def compile_tendons(
    model: mujoco.MjModel, limits: LimitsModel, dofs: NDArray[np.intp]
) -> list[TendonRanges]:
    """Return the ranges of the tendons that joints which may move lengthen or shorten."""
    if limits.position == "off":
        return []
    entries = []
    for tendon in np.flatnonzero(model.tendon_limited).tolist():
        levers = tendon_levers(model, tendon)
        if levers[dofs].any():
            low, high = model.tendon_range[tendon]
            entries += [(tendon, 1.0, low, levers), (tendon, -1.0, high, levers)]
    if not entries:
        return []
    tendons, sign, bound, rows = zip(*entries, strict=True)
    fixed = all(is_fixed(model, tendon) for tendon in tendons)
    return [
        TendonRanges(
            np.array(tendons),
            np.array(sign),
            np.array(bound),
            np.array(rows),
            limits.position.gain,
            fixed,
        )
    ]


def wraps(model: mujoco.MjModel, tendon: int) -> range:
    """Return the ids of what a tendon is made of."""
    first = int(model.tendon_adr[tendon])
    return range(first, first + int(model.tendon_num[tendon]))


def is_fixed(model: mujoco.MjModel, tendon: int) -> bool:
    """Return whether a tendon is a sum of joint coordinates."""
    return bool((model.wrap_type[wraps(model, tendon)] == _WRAP.mjWRAP_JOINT).all())


def coefficients(model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Return the coefficient of each joint in the sum that a fixed tendon is, in their order."""
    sums: dict[int, float] = {}
    for wrap in wraps(model, tendon):
        joint = int(model.wrap_objid[wrap])
        sums[joint] = sums.get(joint, 0.0) + float(model.wrap_prm[wrap])
    return dict(sorted(sums.items()))


def tendon_levers(model: mujoco.MjModel, tendon: int) -> Array:
    """Return how fast each dof can change a tendon's length (nv,), at most.

    In space each point moves two pieces of the path, and a geom that the path bends round carries
    two points.
    """
    row = np.zeros(model.nv)
    if is_fixed(model, tendon):
        for joint, coefficient in coefficients(model, tendon).items():
            row[model.jnt_dofadr[joint]] = abs(coefficient)
        return row
    for wrap in wraps(model, tendon):
        kind, i = _WRAP(int(model.wrap_type[wrap])), int(model.wrap_objid[wrap])
        if kind == _WRAP.mjWRAP_SITE:
            reach = float(np.linalg.norm(model.site_pos[i]))
            row += 2.0 * body_levers(model, int(model.site_bodyid[i]), reach)[: model.nv]
        elif kind in (_WRAP.mjWRAP_SPHERE, _WRAP.mjWRAP_CYLINDER):
            reach = float(np.linalg.norm(model.geom_pos[i]) + model.geom_rbound[i])
            row += 4.0 * body_levers(model, int(model.geom_bodyid[i]), reach)[: model.nv]
    return row


class TendonRange(Barrier):
    """h = L − L_min and h = L_max − L of each tendon's length L, with ∂h/∂q = ±∂L/∂q.

    All tendons always have their rows: with acceleration limits one may bind long before a step
    can bring L to its limit.
    """

    kind: ClassVar[str] = "position"
    unit: ClassVar[str] = "m"

    def __init__(self, model: mujoco.MjModel, spec: TendonRanges):
        self.gain, self.push = spec.gain, math.inf  # the box says how fast its joints come back
        self._model, self.spec, self.size = model, spec, spec.tendons.size
        self._ids, self._none = np.arange(self.size), np.zeros(self.size)

    def near(self, data: mujoco.MjData, travel: Array, dt: float) -> Near:
        """Return all ends."""
        lengths = self._lengths(data)
        slope = self._jacobian(data)[self.spec.tendons] * self.spec.sign[:, None]
        distance = self.spec.sign * (lengths[self.spec.tendons] - self.spec.bound)
        return Near(self._ids, distance, slope, self._none)

    def distances(self, data: mujoco.MjData, ids: Ids) -> Array:
        """Return h of some ends (k,)."""
        spec = self.spec
        return spec.sign[ids] * (self._lengths(data)[spec.tendons[ids]] - spec.bound[ids])

    def reach(self, ids: Ids, step: Array, dt: float) -> Array:
        """Return the sum of the levers' motions."""
        return self.spec.levers[ids] @ np.abs(step)

    def name(self, identity: int) -> str:
        """Return the tendon's name."""
        tendon = int(self.spec.tendons[identity])
        return self._model.tendon(tendon).name or f"tendon {tendon}"

    def least(self, data: mujoco.MjData) -> tuple[float, int]:
        """Return the least h and the end's place in the list."""
        distances = self.distances(data, self._ids)
        least = int(np.argmin(distances))
        return float(distances[least]), least

    def _lengths(self, data: mujoco.MjData) -> Array:
        mujoco.mj_tendon(self._model, data)
        return data.ten_length

    def _jacobian(self, data: mujoco.MjData) -> Array:
        """Return ∂L/∂q (ntendon, nv), as `mj_tendon` has left it."""
        model = self._model
        numbers = np.asarray(data.ten_J)
        if numbers.size == model.ntendon * model.nv:
            return numbers.reshape(model.ntendon, model.nv)
        dense = np.empty((model.ntendon, model.nv))
        source = model if hasattr(model, "ten_J_rownnz") else data
        layout = (source.ten_J_rownnz, source.ten_J_rowadr, source.ten_J_colind)
        mujoco.mju_sparse2dense(dense, numbers.ravel(), *(np.ravel(part) for part in layout))
        return dense


TendonEnd = tuple[float, float, list[int], list[int], list[float]]


def described(model: mujoco.MjModel, spec: TendonRanges) -> list[TendonEnd]:
    """Return each end of fixed tendons as sign, bound, and coordinates, dofs and coefficients."""
    ends: list[TendonEnd] = []
    for tendon, sign, bound in zip(spec.tendons, spec.sign, spec.bound, strict=True):
        sums = coefficients(model, int(tendon))
        joints = np.array(list(sums), dtype=int)
        ends.append(
            (
                float(sign),
                float(bound),
                model.jnt_qposadr[joints].tolist(),
                model.jnt_dofadr[joints].tolist(),
                list(sums.values()),
            )
        )
    return ends
