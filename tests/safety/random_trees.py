"""Random robots among obstacles at any scale, that start apart from all that they must not hit."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import rmrc
from models import config

Array = NDArray[np.float64]

KINDS = {"sphere": 1, "capsule": 2, "box": 3, "cylinder": 2, "ellipsoid": 3}
"""Geoms, and how many sizes each has."""
FAR = 1e9
"""m; what MuJoCo says of a capsule and a box it takes to be this far apart is not meant."""
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def _text(numbers: Any) -> str:
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(numbers))


class _Tree:
    """MJCF of a tree of random bodies, all of whose lengths are multiples of `scale`."""

    def __init__(self, rng: np.random.Generator, scale: float):
        self._rng, self._scale, self._bodies = rng, scale, 0

    def scene(self, joints: int) -> str:
        rng, world = self._rng, ""
        while joints > 0:
            some = joints if rng.random() < 0.6 else int(rng.integers(1, joints + 1))
            world, joints = world + self._body(some, True), joints - some
        for k in range(int(rng.integers(1, 5))):
            world += f'<body pos="{_text(self._vector(0.9))}">{self._geom(f"post{k}", 1.5)}</body>'
        if rng.random() < 0.3:
            down = -self._scale * rng.uniform(0.3, 1.5)
            world += f'<geom name="floor" type="plane" size="0 0 1" pos="0 0 {down}"/>'
        return f'<mujoco><compiler angle="radian"/><worldbody>{world}</worldbody></mujoco>'

    def _vector(self, length: float) -> Array:
        return self._scale * length * self._rng.normal(size=3)

    def _geom(self, name: str, larger: float = 1.0) -> str:
        kind = str(self._rng.choice(list(KINDS), p=[0.35, 0.3, 0.2, 0.1, 0.05]))
        size = (self._scale * larger * self._rng.uniform(0.03, 0.12, 3))[: KINDS[kind]]
        place, turn = self._vector(0.05), self._rng.normal(size=4)
        return (
            f'<geom name="{name}" type="{kind}" size="{_text(size)}" pos="{_text(place)}"'
            f' quat="{_text(turn)}" mass="1"/>'
        )

    def _body(self, joints: int, root: bool) -> str:
        rng, number = self._rng, self._bodies
        self._bodies += 1
        text = f'<body pos="{_text(self._vector(0.8 if root else 0.25))}">'
        if root and rng.random() < 0.15:
            text += f'<freejoint name="free{number}"/>'
        else:
            text += self._joint(f"joint{number}")
        text += self._geom(f"geom{number}")
        joints -= 1
        while joints > 0:
            some = joints if rng.random() < 0.7 else int(rng.integers(1, joints + 1))
            text, joints = text + self._body(some, False), joints - some
        return text + "</body>"

    def _joint(self, name: str) -> str:
        rng = self._rng
        kind = str(rng.choice(["hinge", "slide", "ball"], p=[0.55, 0.33, 0.12]))
        anchor, axis = self._vector(0.05), rng.normal(size=3)
        text = f'<joint name="{name}" type="{kind}" pos="{_text(anchor)}"'
        low, high, by = (0.02, 0.4, self._scale) if kind == "slide" else (0.2, 4.0, 1.0)
        ends = by * rng.uniform(low, high, 2)
        if kind != "ball":
            text += f' axis="{_text(axis)}"'
            if rng.random() < 0.5:
                text += f' range="{_text([-ends[0], ends[1]])}"'
        return text + "/>"


@dataclass(frozen=True)
class Case:
    """A random robot with random limits, and the same at scale 1 to measure its distances by."""

    problem: rmrc.Problem
    unit: mujoco.MjModel
    scale: float
    pairs: NDArray[np.intp]
    d_min: float
    """At scale 1."""

    def distances(self, data: mujoco.MjData, q: Array) -> Array:
        """Return the distances (p,) at q, as multiples of the scale, by MuJoCo at scale 1."""
        data.qpos[:] = q / lengths(self.unit, self.scale)
        mujoco.mj_kinematics(self.unit, data)
        return _distances(self.unit, data, self.pairs)

    def goal(self, rng: np.random.Generator) -> Array:
        """Return a configuration somewhere about the start."""
        model, q = self.problem.model, self.problem.start.copy()
        shifts = model.jnt_type[model.dof_jntid] == _SLIDE
        for joint in np.flatnonzero(model.jnt_type == _FREE):
            shifts[model.jnt_dofadr[joint] : model.jnt_dofadr[joint] + 3] = True
        way = rng.normal(size=model.nv) * np.where(shifts, self.scale, 1.5)
        mujoco.mj_integratePos(model, q, way, 1.0)
        return q


def lengths(model: mujoco.MjModel, scale: float) -> Array:
    """Return the scale for each coordinate that is a length (nq,), and 1 for each other."""
    found = np.ones(model.nq)
    for kind, first in zip(model.jnt_type, model.jnt_qposadr, strict=True):
        found[first : first + {_SLIDE: 1, _FREE: 3}.get(int(kind), 0)] = scale
    return found


def _distances(model: mujoco.MjModel, data: mujoco.MjData, pairs: NDArray[np.intp]) -> Array:
    return np.array(
        [mujoco.mj_geomDistance(model, data, *pair, FAR, None) for pair in pairs.tolist()]
    )


def case(seed: int, scale: float, folder: Path) -> Case:
    """Return a random robot, a fourth of whose slides start far outside the model's range."""
    rng = np.random.default_rng(seed)
    joints, shape = int(rng.integers(1, 9)), int(rng.integers(2**31))
    unit, scaled = (_Tree(np.random.default_rng(shape), s).scene(joints) for s in (1.0, scale))
    path = folder / f"tree{seed}_{scale:g}.xml"
    path.write_text(scaled)
    model = mujoco.MjModel.from_xml_string(unit)
    names = {model.joint(j).name: int(model.jnt_type[j]) for j in range(model.njnt)}
    size = {name: scale if kind == _SLIDE else 1.0 for name, kind in names.items()}
    scalar = [name for name, kind in names.items() if kind in (_SLIDE, _HINGE)]
    start, ranges = {}, {}
    for name in scalar:
        far = rng.choice([0.3, 0.3, 0.3, 20.0]) if names[name] == _SLIDE else 1.0
        start[name] = float(rng.normal() * far * (rng.random() < 0.5))
        room = start[name] + np.array([-1.0, 1.0]) * rng.uniform(0.0, 3.0, 2)
        ranges[name] = (room * size[name]).tolist()
    position: Any = "off" if rng.random() < 0.3 else ranges
    limits: dict[str, Any] = {"position": position, "velocity": {"default": rng.uniform(0.5, 4)}}
    slides = [name for name in scalar if names[name] == _SLIDE]
    limits["velocity"] |= {name: scale * rng.uniform(0.3, 3) for name in slides}
    if rng.random() < 0.6:
        limits["acceleration"] = {"default": rng.uniform(1, 30)}
        limits["acceleration"] |= {name: scale * rng.uniform(0.5, 20) for name in slides}
    if (model.jnt_type == _FREE).any():
        limits["base"] = {"linear": scale * rng.uniform(0.3, 2), "angular": rng.uniform(0.5, 3)}
    d_min = float(rng.choice([0.0, 0.005, 0.01, 0.03]))
    pairs = _apart(model, start, d_min)
    limits["collision"] = {
        "pairs": [[model.geom(g).name for g in pair] for pair in pairs.tolist()],
        "d_min": d_min * scale,
        "detect": (d_min + rng.uniform(0.01, 0.1)) * scale,
    }
    made = config(
        str(path),
        [{"name": "joints", "type": "posture", "gain": rng.uniform(2, 20)}],
        dt=float(10.0 ** rng.uniform(-4, -1)),
        start={name: value * size[name] for name, value in start.items()} or None,
        limits=limits,
    )
    return Case(rmrc.compile(made), model, scale, pairs, d_min)


def _apart(model: mujoco.MjModel, start: dict[str, float], d_min: float) -> NDArray[np.intp]:
    """Return the pairs that a joint moves and that are apart at the start, by the lower type."""
    data, moves = mujoco.MjData(model), np.zeros((model.nbody, model.nv), dtype=bool)
    for body in range(1, model.nbody):
        moves[body] = moves[model.body_parentid[body]]
        moves[body, model.body_dofadr[body] : model.body_dofadr[body] + model.body_dofnum[body]] = 1
    for name, value in start.items():
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_kinematics(model, data)
    of_geom, order = moves[model.geom_bodyid], np.argsort(model.geom_type, kind="stable")
    pairs = [(a, b) for i, a in enumerate(order) for b in order[i + 1 :]]
    moved = np.array([pair for pair in pairs if (of_geom[pair[0]] != of_geom[pair[1]]).any()])
    distance = _distances(model, data, moved)
    return moved[(distance > d_min) & (distance < FAR)]
