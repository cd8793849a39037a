"""What a configuration asks of a model, read from the two by code that the package does not share.

What the package drops on its way from names to numbers is then found missing.
"""

from itertools import product
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

import rmrc
from soaking.drawer import Array

Mask = NDArray[np.bool_]
_T, _G = mujoco.mjtJoint, mujoco.mjtGeom
HINGE_SPEED, SLIDE_SPEED = np.pi, 1.0
"""rad/s and m/s of joints that nothing is said of."""
NEVER_MEASURED = (_G.mjGEOM_HFIELD, _G.mjGEOM_SDF)


class Contract:
    """The limits of a configuration, one entry a dof (nv,), pair, plane or frame."""

    def __init__(self, config: rmrc.Config, model: mujoco.MjModel):
        self.model, self.limits = model, config.limits
        self._tasks = [task.model_dump() for task in config.tasks]
        self.width = np.array(
            [{_T.mjJNT_FREE: 6, _T.mjJNT_BALL: 3}.get(_T(k), 1) for k in model.jnt_type]
        )
        self.kind = model.jnt_type[model.dof_jntid]
        self.object = self._objects(config)
        """Whether a dof is an object's."""
        self.moves = ~self.object
        """Whether a dof may move."""
        if config.dofs is not None:
            self.moves &= self._of(config.dofs)
        self.mocap = self._mocap(config)
        """Positions (nmocap, 3) and quaternions (nmocap, 4) at the start."""
        self.lower, self.upper, self.balls = self._positions()
        self.velocity = self._velocities()
        self.acceleration = self._per_joint(config.limits.acceleration, np.inf)
        self.jerk = self._per_joint(config.limits.jerk, np.inf)
        self.pairs = self._pairs()
        self.d_min = 0.0 if config.limits.collision == "off" else config.limits.collision.d_min

    def differences(self, box: Any, dofs: NDArray[np.intp]) -> list[str]:
        """Return which limits of a compiled box are not those that were asked for."""
        asked = {
            "lower": self.lower,
            "upper": self.upper,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "jerk": self.jerk,
        }
        return [
            name
            for name, values in asked.items()
            if not np.allclose(getattr(box, name), values[dofs], rtol=1e-12, atol=1e-12)
        ]

    def take(self, box: Any, dofs: NDArray[np.intp]) -> None:
        """Take over limits that have changed on the way."""
        for name in ("lower", "upper", "velocity", "acceleration", "jerk"):
            getattr(self, name)[dofs] = getattr(box, name)

    def _of(self, joints: Any) -> Mask:
        """Return which dofs are those of some joints."""
        named = [self.model.joint(name).id for name in joints]
        return np.isin(self.model.dof_jntid, named)

    def _objects(self, config: rmrc.Config) -> Mask:
        """Return the dofs of trees that nothing drives, no task moves and nobody names."""
        model = self.model
        claimed = self._of(config.dofs or ()) | _actuated(model)
        roots = set(model.body_rootid[model.dof_bodyid[claimed]].tolist())
        for task in self._tasks:
            roots |= {int(model.body_rootid[body]) for body in self._claimed(task)}
        idle = ~np.isin(model.body_rootid[model.dof_bodyid], list(roots))
        if idle.all():
            free = model.body_rootid[model.jnt_bodyid[model.jnt_type == int(_T.mjJNT_FREE)]]
            joints = np.bincount(model.body_rootid[model.jnt_bodyid], minlength=model.nbody)
            idle = np.isin(model.body_rootid[model.dof_bodyid], free[joints[free] == 1])
        return idle if not idle.all() else np.zeros_like(idle)

    def _claimed(self, task: dict[str, Any]) -> list[int]:
        """Return the bodies that a task moves, or whose joints it names."""
        model, found = self.model, []
        if task["type"] in ("frame", "relative_frame", "look_at", "axis_align", "manipulability"):
            found.append(_body(model, task["frame"]))
        if task["type"] == "com" and task["body"]:
            found.append(model.body(task["body"]).id)
        joints = [*(task.get("joints") or ()), *(task.get("coefficients") or ())]
        joints += task["target"] if isinstance(task.get("target"), dict) else ()
        if task["type"] == "loop":
            for name in task["equalities"] or range(model.neq):
                k = model.equality(name).id
                ends = [model.eq_obj1id[k], model.eq_obj2id[k]]
                if model.eq_type[k] == mujoco.mjtEq.mjEQ_TENDON:
                    first = model.tendon_adr[ends[0]]
                    wraps = model.wrap_objid[first : first + model.tendon_num[ends[0]]]
                    joints += [model.joint(j).name for j in wraps]
                elif model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
                    joints += [model.joint(j).name for j in ends if j >= 0]
                else:
                    found += ends
        return found + [int(model.jnt_bodyid[model.joint(name).id]) for name in joints]

    def _mocap(self, config: rmrc.Config) -> tuple[Array, Array]:
        model = self.model
        bodies = np.argsort(np.where(model.body_mocapid < 0, model.nbody, model.body_mocapid))
        bodies = bodies[: model.nmocap]
        keys = [model.key(k).name for k in range(model.nkey)]
        key = config.start if isinstance(config.start, str) else "home"
        if key in keys and model.nmocap:
            k = keys.index(key)
            quaternions = model.key_mquat[k].reshape(-1, 4)
            norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
            return model.key_mpos[k].reshape(-1, 3).copy(), quaternions / norms
        return model.body_pos[bodies].copy(), model.body_quat[bodies].copy()

    def _positions(self) -> tuple[Array, Array, list[tuple[int, float]]]:
        """Return the ranges of hinges and slides (nv,), and joint and angle of limited balls."""
        model, limit = self.model, self.limits.position
        lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        balls: list[tuple[int, float]] = []
        if limit == "off":
            return lower, upper, balls
        controls = _controls(model)
        for joint in range(model.njnt):
            name, kind = model.joint(joint).name, model.jnt_type[joint]
            ends = limit.named.get(name)
            if ends is None and model.jnt_limited[joint]:
                ends = tuple(model.jnt_range[joint])
            if ends is None and joint not in controls:
                continue
            low, high = ends or (-np.inf, np.inf)
            if kind == _T.mjJNT_BALL:
                if high - limit.margin < np.pi:
                    balls.append((joint, high - limit.margin))
                continue
            if name not in limit.named and joint in controls:
                least, most = controls[joint]
                inside = least <= low + 1e-9 and most >= high - 1e-9
                if not inside and max(low, least) <= min(high, most):
                    low, high = max(low, least), min(high, most)
            dof = model.jnt_dofadr[joint]
            margin = limit.margin if low < high else 0.0  # where it has to stand
            lower[dof], upper[dof] = low + margin, high - margin
        return lower, upper, balls

    def _velocities(self) -> Array:
        model, limits = self.model, self.limits
        speed = self._per_joint(limits.velocity, np.inf)
        if limits.velocity != "off":
            unsaid = np.isinf(speed)
            speed[unsaid] = np.where(self.kind == _T.mjJNT_SLIDE, SLIDE_SPEED, HINGE_SPEED)[unsaid]
            for joint, fastest in _fastest(model).items():
                dof = model.jnt_dofadr[joint]
                speed[dof] = fastest if unsaid[dof] else speed[dof]
        base = {} if limits.base == "off" else limits.base.model_dump()
        for joint in np.flatnonzero(model.jnt_type == _T.mjJNT_FREE):
            first = model.jnt_dofadr[joint]
            speed[first : first + 3] = base.get("linear") or np.inf
            speed[first + 3 : first + 6] = base.get("angular") or np.inf
        for task in self._tasks:
            if task["type"] == "freeze":
                speed[self._of(task["joints"])] = 0.0
        return speed

    def _per_joint(self, limit: Any, none: float) -> Array:
        values = np.full(self.model.nv, none)
        if limit == "off":
            return values
        if limit.default is not None:
            values[self.kind != _T.mjJNT_FREE] = limit.default
        for name, value in limit.named.items():
            values[self._of([name])] = value
        return values

    def _pairs(self) -> NDArray[np.intp]:
        """Return the pairs of geoms (p, 2) that stay apart, the lower type first."""
        model, limit = self.model, self.limits.collision
        if limit == "off":
            return np.zeros((0, 2), dtype=np.intp)
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        chosen: set[tuple[int, int]] = set()
        if limit.pairs == "all":
            asked = {tuple(sorted(p)) for p in zip(model.pair_geom1, model.pair_geom2, strict=True)}
            for a, b in product(range(model.ngeom), repeat=2):
                masks = model.geom_contype[a] & model.geom_conaffinity[b]
                if a != b and masks and not self._filtered(a, b):
                    chosen.add((min(a, b), max(a, b)))
            chosen |= {(int(a), int(b)) for a, b in asked}
        else:
            for names in limit.pairs:
                (first, grouped), (second, also) = (self._geoms(name, collides) for name in names)
                for a, b in product(first, second):
                    if a != b and not ((grouped or also) and self._filtered(a, b)):
                        chosen.add((min(a, b), max(a, b)))
        for names in limit.exclude:
            every = np.ones_like(collides)
            (first, _), (second, _) = (self._geoms(name, every) for name in names)
            chosen -= {(min(a, b), max(a, b)) for a, b in product(first, second)}
        moved = [self._moved(body) for body in range(model.nbody)]
        kept = [
            (a, b) if model.geom_type[a] <= model.geom_type[b] else (b, a)
            for a, b in sorted(chosen)
            if (moved[model.geom_bodyid[a]] != moved[model.geom_bodyid[b]]).any()
            and not np.isin(model.geom_type[[a, b]], NEVER_MEASURED).any()
            and not (model.geom_type[[a, b]] == _G.mjGEOM_PLANE).all()
        ]
        return np.array(kept, dtype=np.intp).reshape(-1, 2)

    def _geoms(self, name: object, collides: Mask) -> tuple[list[int], bool]:
        """Return the geoms that a name stands for, and whether it is a group's."""
        model, groups = self.model, self.limits.collision.groups  # pyright: ignore
        assert isinstance(name, str), "the soak names no subtree"
        if name in groups:
            return [g for member in groups[name] for g in self._geoms(member, collides)[0]], True
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        if body < 0:
            return [model.geom(name).id], False
        own = np.flatnonzero(model.geom_bodyid == body)
        return (own[collides[own]] if collides[own].any() else own).tolist(), False

    def _filtered(self, a: int, b: int) -> bool:
        """Return whether MuJoCo does not let two geoms collide, whatever their masks say."""
        model = self.model
        first, second = sorted(int(model.geom_bodyid[g]) for g in (a, b))
        if (first << 16) + second in model.exclude_signature.tolist():
            return True
        welds = [int(model.body_weldid[body]) for body in (first, second)]
        parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
        return 0 not in welds and (welds[0] == parents[1] or welds[1] == parents[0])

    def _moved(self, body: int) -> Mask:
        """Return which of the dofs that may move, move a body."""
        model, found = self.model, np.zeros(self.model.nv, dtype=np.bool_)
        while body:
            first = model.body_dofadr[body]
            found[first : first + model.body_dofnum[body]] = True
            body = int(model.body_parentid[body])
        return found & self.moves


def _body(model: mujoco.MjModel, frame: dict[str, str | None]) -> int:
    if frame["body"]:
        return model.body(frame["body"]).id
    if frame["site"]:
        return int(model.site_bodyid[model.site(frame["site"]).id])
    return int(model.geom_bodyid[model.geom(frame["geom"]).id])


def _actuated(model: mujoco.MjModel) -> Mask:
    """Return which dofs an actuator drives: of a joint, or of the joints of a tendon."""
    found = np.zeros(model.nv, dtype=np.bool_)
    for k in range(model.nu):
        kind, target = mujoco.mjtTrn(int(model.actuator_trntype[k])), model.actuator_trnid[k, 0]
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            found |= model.dof_jntid == target
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            wraps = slice(
                model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target]
            )
            found |= np.isin(model.dof_jntid, model.wrap_objid[wraps])
    return found


def _servos(model: mujoco.MjModel, order: Literal[1, 2]) -> list[tuple[int, Array]]:
    """Return joint and control range, by the gear, of the actuators k (u − x) on single joints."""
    found = []
    for k in range(model.nu):
        bias, joint = model.actuator_biasprm[k], int(model.actuator_trnid[k, 0])
        alone = model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
        alone &= bool(model.actuator_ctrllimited[k])
        alone &= model.jnt_type[joint] >= int(_T.mjJNT_SLIDE)
        if alone and model.actuator_gainprm[k, 0] == -bias[order] > 0.0 == bias[:order].any():
            found.append((joint, np.sort(model.actuator_ctrlrange[k] / model.actuator_gear[k, 0])))
    return found


def _controls(model: mujoco.MjModel) -> dict[int, tuple[float, float]]:
    found: dict[int, tuple[float, float]] = {}
    for joint, (low, high) in _servos(model, 1):
        least, most = found.get(joint, (-np.inf, np.inf))
        found[joint] = (max(least, low), min(most, high))
    return found


def _fastest(model: mujoco.MjModel) -> dict[int, float]:
    found: dict[int, float] = {}
    for joint, (low, high) in _servos(model, 2):
        if low < 0.0 < high:
            found[joint] = min(found.get(joint, np.inf), -low, high)
    return found
