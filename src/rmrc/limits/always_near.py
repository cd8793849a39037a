"""Pairs of geoms that no configuration keeps apart, as neighbours in a chain often are."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.distance import is_capsule_and_box, signed_distance
from rmrc.model.extents import dofs_of_bodies, extents

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

CONFIGURATIONS = 64
"""Random configurations that are looked at, half of them with each joint at an end of its range."""
PLACES, SWEEPS = 9, 2
"""Places of a joint in its range that a search for more distance tries, and how often it does."""
SCALES = np.geomspace(1e-2, 1e2, 5)
"""Shifts without a range that are tried, as multiples of what surely takes a pair apart."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_BALL = mujoco.mjtJoint.mjJNT_BALL


@dataclass(frozen=True, eq=False)
class Whereabouts:
    """Where the joints may be: at the start, and for those that may move within their ranges."""

    start: Array
    """q (nq,)."""
    ranges: Array
    """Of each joint (njnt, 2), infinite without one; of a ball joint [0, its largest angle]."""
    dofs: Ids
    """The dofs that may move."""


def anywhere(model: mujoco.MjModel) -> Whereabouts:
    """Return the model's own ranges about its own start."""
    ranges = np.tile([-np.inf, np.inf], (model.njnt, 1))
    limited = np.flatnonzero(model.jnt_limited)
    ranges[limited] = model.jnt_range[limited]
    return Whereabouts(model.qpos0, ranges, np.arange(model.nv))


def always_near(
    model: mujoco.MjModel, pairs: Ids, d_min: float, where: Whereabouts
) -> NDArray[np.bool_]:
    """Return which pairs (p, 2) are nearer than d_min wherever the joints may be (p,).

    A pair is, if it is nearer at the start, in some random configurations, and in those to which a
    search from the best of these leads that moves one joint after another.
    """
    return _Search(model, pairs, d_min, where).always_near()


class _Search:
    """Looks for configurations in which pairs are further apart than d_min."""

    def __init__(self, model: mujoco.MjModel, pairs: Ids, d_min: float, where: Whereabouts):
        self._model, self._data = model, mujoco.MjData(model)
        self._pairs, self._d_min, self._start = pairs, d_min, where.start
        self._measures = [(a, b, is_capsule_and_box(model, a, b)) for a, b in pairs.tolist()]
        self._segment = np.empty(6)
        apart = d_min + 2.0 * (extents(model) * (model.geom_rbound > 0.0)).max(initial=0.0)
        shift = apart + float(np.linalg.norm(model.body_pos, axis=1).sum())
        self._free = np.zeros(model.nv, dtype=np.bool_)
        self._free[where.dofs] = True
        lower, upper = np.zeros((2, model.nv))
        """How far each dof may move from the start, rad or m."""
        self._unlimited = np.zeros(model.nv, dtype=np.bool_)
        for joint in range(model.njnt):
            kind, dof = model.jnt_type[joint], int(model.jnt_dofadr[joint])
            if kind == _FREE:
                some, far = slice(dof, dof + 3), slice(dof + 3, dof + 6)
                upper[some], upper[far], self._unlimited[some] = shift, np.pi, True
                lower[dof : dof + 6] = -upper[dof : dof + 6]
            elif kind == _BALL:
                # About the start: ± the whole of the range, in which `_inside` keeps it.
                upper[dof : dof + 3] = min(2.0 * where.ranges[joint, 1], np.pi)
                lower[dof : dof + 3] = -upper[dof : dof + 3]
            else:
                slides = kind == mujoco.mjtJoint.mjJNT_SLIDE
                way = where.ranges[joint] - where.start[model.jnt_qposadr[joint]]
                unbounded = shift if slides else np.pi
                lower[dof] = min(0.0, way[0] if np.isfinite(way[0]) else -unbounded)
                upper[dof] = max(0.0, way[1] if np.isfinite(way[1]) else unbounded)
                self._unlimited[dof] = slides and not np.isfinite(way).all()
        self._lower, self._upper = lower * self._free, upper * self._free
        self._balls = [
            (int(model.jnt_qposadr[joint]), float(where.ranges[joint, 1]))
            for joint in np.flatnonzero(model.jnt_type == _BALL).tolist()
        ]
        moves = dofs_of_bodies(model)[model.geom_bodyid[pairs]]
        self._parting = (moves[:, 0] != moves[:, 1]) & self._free

    def always_near(self) -> NDArray[np.bool_]:
        rng, count = np.random.default_rng(0), len(self._pairs)
        near, best = np.arange(count), np.full(count, -np.inf)
        way = np.zeros((count, self._model.nv))
        for k in range(1 + CONFIGURATIONS):
            tried = self._random(rng, at_ends=k % 2 == 0) if k else np.zeros(self._model.nv)
            self._place(tried)
            distance = np.array([self._distance(pair) for pair in near.tolist()])
            better = distance > best[near]
            best[near[better]], way[near[better]] = distance[better], tried
            near = near[~(distance >= self._d_min)]
            if not near.size:
                break
        found = np.zeros(count, dtype=np.bool_)
        found[near] = [not self._part(pair, way[pair], best[pair]) for pair in near.tolist()]
        return found

    def _part(self, pair: int, way: Array, best: float) -> bool:
        """Return whether moving one joint after another from a way (nv,) takes a pair apart."""
        for _ in range(SWEEPS):
            for dof in self._parting[pair].nonzero()[0].tolist():
                tried = way.copy()
                for place in self._places(dof).tolist():
                    tried[dof] = place
                    self._place(tried)
                    distance = self._distance(pair)
                    if distance > best:
                        best, way = distance, tried.copy()
                    if best >= self._d_min:
                        return True
        return False

    def _places(self, dof: int) -> Array:
        if self._unlimited[dof]:
            return np.outer(SCALES, [self._lower[dof], self._upper[dof]]).ravel()
        return np.linspace(self._lower[dof], self._upper[dof], PLACES)

    def _random(self, rng: np.random.Generator, at_ends: bool) -> Array:
        """Return a way from the start (nv,)."""
        way = rng.uniform(self._lower, self._upper)
        if at_ends:
            way = np.where(rng.random(way.size) < 0.5, self._lower, self._upper)
        return np.where(self._unlimited, rng.choice(SCALES) * way, way)

    def _place(self, way: Array) -> None:
        """Run the kinematics behind a way (nv,) from the start."""
        qpos = self._data.qpos
        qpos[:] = self._start
        mujoco.mj_integratePos(self._model, qpos, way, 1.0)
        for first, largest in self._balls:
            _turn_back(qpos[first : first + 4], largest)
        mujoco.mj_kinematics(self._model, self._data)

    def _distance(self, pair: int) -> float:
        measure, most = self._measures[pair], 2.0 * self._d_min + 1.0
        return signed_distance(self._model, self._data, measure, most, self._segment)


def _turn_back(quaternion: Array, largest: float) -> None:
    """Turn a rotation back, in place, to no more than the largest angle."""
    turn = np.empty(3)
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    angle = float(np.linalg.norm(turn))
    if angle > largest:
        mujoco.mju_axisAngle2Quat(quaternion, turn / angle, largest)
