"""What a step promises, checked from the problem's numbers by code that no engine shares."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

import rmrc
from rmrc.control.status import Status
from rmrc.control.step import Step
from rmrc.problem.problem import Problem
from rmrc.qp.program import QP, Solution, SolveStatus
from soaking.contract import Contract
from soaking.drawer import Array
from soaking.shaking import Shaking

Pairs = NDArray[np.intp]

EXACT = 1e-9
"""Largest violation of a joint limit: in rad, rad/s or rad/s times dt, or m."""
MEASURED = 1e-6
"""Largest violation of a row: solvers, and measurements of distances, are no finer."""
DEEP = 0.02
"""Share of the depth by which the depth of an overlap is known."""
ROUNDING = 4.0 * np.finfo(float).eps
"""Share of a number by which sums of it may be off."""
RANK = 1e-5
"""Share of the largest singular value below which constraints may count as dependent."""
AT_REST = 1e-12
"""rad/s and rad/s² up to which a joint stands still."""

TOLERANCE = {
    "finite": 0.0,
    "still": 0.0,
    "object": 0.0,
    "integrated": 0.0,
    "late": 0.0,
    "brake": EXACT,
    "velocity": EXACT,
    "acceleration": EXACT,
    "jerk": EXACT,
    "position": EXACT,
    "return": EXACT,
    "speed": MEASURED,
    "ball": MEASURED,
    "workspace": MEASURED,
    "distance": MEASURED,
    "equality": MEASURED,
    "loop": MEASURED,
    "certificate": MEASURED,
    "residual": MEASURED,
    "reported": 0.0,
    "shaking": 0.0,
}
"""What is checked of a step, and the largest violation that passes."""
HURRIED = 1 << Status.MAX_ITER | 1 << Status.DEADLINE
"""Steps without an optimum: what they command depends on how far they came."""


@dataclass
class Moment:
    """What a step starts from."""

    q: Array
    """Configuration (nq,), as the controller takes it."""
    v: Array
    """Velocity (nv,) that accelerations count from."""
    a: Array
    """Acceleration (nv,) that jerks count from."""
    dt: float
    mocap: tuple[Array, Array, Array]
    """Positions, quaternions and twists of the mocap bodies (nmocap, ·)."""
    braking: bool
    """Whether what came in leaves nothing but to brake."""
    invalid: bool
    """Whether something that came in is not valid."""
    rest: bool = False
    """Whether targets and obstacles rest, were so at the step before, and dt is the usual one."""
    overtime: float = 0.0
    """Time in s that the step took beyond what it may."""


def carried(position: Array, quaternion: Array, twist: Array, dt: float) -> tuple[Array, Array]:
    """Return the positions and quaternions of the mocap bodies after a step of dt."""
    quaternions = quaternion.copy()
    for quaternion, rate in zip(quaternions, twist[:, 3:], strict=True):
        turn, angle = np.empty(4), float(np.linalg.norm(rate))
        mujoco.mju_axisAngle2Quat(turn, rate / (angle or 1.0), angle * dt)
        mujoco.mju_mulQuat(quaternion, turn, quaternion.copy())
    return position + twist[:, :3] * dt, quaternions


class Checker:
    """Measures by how much steps of one problem pass their limits."""

    def __init__(self, problem: Problem, contract: Contract):
        self._problem, self._model, self._contract = problem, problem.model, contract
        self._data = mujoco.MjData(problem.model)
        self._calm = np.zeros(problem.dofs.size, dtype=bool)
        """The joints that have stood still inside their range since the last disturbance."""
        self._shaking = Shaking(problem.dofs.size)
        model, config = problem.model, problem.config
        self._pairs, self._d_min = contract.pairs, contract.d_min
        radius = model.geom_rbound[self._pairs]
        # A plane has no bounding sphere, and is always near.
        self._near = np.where((radius > 0.0).all(axis=1), radius.sum(axis=1), np.inf)
        self._kept = {pair for barrier in problem.barriers for pair in _pairs_of(barrier)}
        """The pairs that the package has not left out."""
        self._planes = config.limits.workspace
        self._speeds = [
            (task.frame, config.limits.speed[task.name])
            for task in config.tasks
            if task.type == "frame" and task.name in config.limits.speed
        ]
        hard = [task for task in config.tasks if getattr(task, "hard", False)]
        self._loop = hard[0] if len(hard) == 1 and hard[0].type == "loop" else None
        """The task whose equalities are the only ones, if there is such."""
        self._fixed = np.flatnonzero(contract.object)
        self._certified = not problem.strict and not any(term.preserve for term in problem.terms)

    def disturb(self) -> None:
        """Note that the joints are not where, or as fast as, the last command says."""
        self._calm[:] = False
        self._shaking.forget()

    def check(self, moment: Moment, step: Step, controller: rmrc.Controller) -> dict[str, float]:
        """Return by how much a step passes each limit; 0 or less where it does not."""
        finite = all(np.isfinite(part).all() for part in (step.v, step.q, step.solution.v))
        if not finite:
            return {"finite": np.inf}
        found = {"finite": 0.0, "late": moment.overtime, **self._carried_out(moment, step)}
        found |= self._joints(moment, step.v) | self._ranges(moment, step)
        flags = step.flag_bits
        reported = flags >> Status.INVALID_INPUT & 1 or flags >> Status.STALE & 1
        found["reported"] = float(bool(reported) != (moment.invalid or moment.braking))
        contradiction = flags & (1 << Status.RECOVERING | 1 << Status.RELAXED)
        if moment.braking or not moment.rest or flags & HURRIED or contradiction:
            self._shaking.forget()
        found["shaking"] = self._shaking.update(step.v[self._problem.dofs], moment.dt)
        if moment.braking:
            self._calm[:] = False
            found["brake"] = self._brake(moment, step.v)
            return found
        found |= self._rows(moment, step) | self._closing(moment, step)
        found |= self._optimum(step, controller)
        return found

    def _carried_out(self, moment: Moment, step: Step) -> dict[str, float]:
        """Return how far q is from where v leads, and how far objects have moved."""
        model, q = self._model, moment.q.copy()
        mujoco.mj_integratePos(model, q, step.v, moment.dt)
        # A measured quaternion is as long as its rounding says; beyond that both are MuJoCo's.
        apart = np.abs(step.q - q) - 2.0 * ROUNDING * np.maximum(np.abs(q), 1.0)
        held = np.isin(model.dof_jntid, model.dof_jntid[self._fixed])
        still = np.zeros(model.nq, dtype=bool)
        for joint in np.unique(model.dof_jntid[held]):
            width = {0: 7, 1: 4}.get(int(model.jnt_type[joint]), 1)
            still[model.jnt_qposadr[joint] :][:width] = True
        moved = np.abs(step.q - moment.q)[still] - 2.0 * ROUNDING
        return {
            "integrated": max(float(apart.max()), 0.0),
            "object": max(np.abs(step.v[self._fixed]).max(initial=0.0), moved.max(initial=0.0)),
        }

    def _joints(self, moment: Moment, v: Array) -> dict[str, float]:
        """Return the violations of what limits the velocity of each joint.

        The order of precedence is acceleration, velocity, position, jerk.
        """
        problem, dofs = self._problem, self._problem.dofs
        box, dt = problem.box, moment.dt
        others = np.delete(v, dofs)
        v, before = v[dofs], moment.v[dofs]
        rounding = ROUNDING * (np.abs(v) + np.abs(before))
        change = box.acceleration * dt
        slow = np.maximum(box.velocity, np.abs(before) - change)
        found = {
            "still": float(np.abs(others).max(initial=0.0)),
            "acceleration": float((np.abs(v - before) - change - rounding).max()),
            "velocity": float((np.abs(v) - slow - rounding).max()),
        }
        jerked = self._calm & np.isfinite(box.jerk)
        if jerked.any() and not moment.braking:
            beyond = np.abs(v - before - moment.a[dofs] * dt) - box.jerk * dt * dt - rounding
            found["jerk"] = float(beyond[jerked].max())
        return found

    def _ranges(self, moment: Moment, step: Step) -> dict[str, float]:
        """Return the violations of the ranges, and of a monotonic way back into them.

        A joint that could have stopped in its range still can: v²/2a ≤ q_max − q, mirrored below.
        """
        box, dofs = self._problem.box, self._problem.dofs
        before, after = moment.q[box.coordinate], step.q[box.coordinate]
        v, following = moment.v[dofs], step.v[dofs]
        found = {"position": -np.inf, "return": -np.inf}
        inside = np.ones(v.size, dtype=bool)
        for sign, end in ((1.0, box.upper), (-1.0, box.lower)):
            outward = np.maximum(sign * v, 0.0)
            room, beyond = sign * (end - before), sign * (after - end)
            beyond -= ROUNDING * np.abs(after)
            inside &= room >= 0.0
            stops = (room >= 0.0) & (outward**2 / (2.0 * box.acceleration) <= room + AT_REST)
            returns = (room < 0.0) & (outward <= box.acceleration * moment.dt)
            braking = np.maximum(sign * following, 0.0) ** 2 / (2.0 * box.acceleration)
            passed = (beyond + braking)[stops]
            found["position"] = max(found["position"], float(passed.max(initial=-np.inf)))
            growth = beyond[returns] + room[returns]
            found["return"] = max(found["return"], float(growth.max(initial=-np.inf)))
        still = np.maximum(np.abs(v), np.abs(moment.a[dofs])) <= AT_REST
        self._calm |= still & inside
        return found

    def _brake(self, moment: Moment, v: Array) -> float:
        """Return how far a command is from what braking at the acceleration limit leaves.

        The robot may stay on its line: the joint that takes longest brakes at its limit, and the
        others less, but none gains speed.
        """
        dofs = self._problem.dofs
        before, v, limit = moment.v[dofs], v[dofs], self._problem.box.acceleration * moment.dt
        expected = np.sign(before) * np.maximum(np.abs(before) - limit, 0.0)
        excess = np.abs(v - expected)
        limited = np.flatnonzero(np.isfinite(limit))
        if limited.size:
            others = np.delete(limited, np.argmax(np.abs(before[limited]) / limit[limited]))
            low, high = np.sort([expected[others], before[others]], axis=0)
            excess[others] = np.maximum(low - v[others], v[others] - high)
        return float(excess.max())

    def _rows(self, moment: Moment, step: Step) -> dict[str, float]:
        """Return the violations of frame speeds, planes, angles and distances.

        A pair that the package has left out, as no configuration keeps it apart, may come nearer
        where it is too near already.
        """
        flags, contract = step.flag_bits, self._contract
        asked = self._speeds or self._planes or contract.balls or self._pairs.size
        if flags >> Status.RELAXED & 1 or not asked:
            return {}
        position, quaternion, twist = moment.mocap
        self._move_to(moment.q, position, quaternion)
        found = {}
        # The last rungs of the ladder keep the box and the distances alone.
        if self._speeds and not (flags >> Status.MAX_ITER & 1 or flags >> Status.DEADLINE & 1):
            found["speed"] = self._speed(step.v)
        heights, angles = self._heights(), self._angles()
        pairs, distances = self._distances()
        self._move_to(step.q, *carried(position, quaternion, twist, moment.dt))
        fallen = np.minimum(heights, 0.0) - self._heights()
        found["workspace"] = float(fallen.max(initial=-np.inf))
        risen = self._angles() - np.maximum(angles, 0.0)
        found["ball"] = float(risen.max(initial=-np.inf))
        reached, after = self._distances()
        earlier = {(a, b): d for (a, b), d in zip(pairs.tolist(), distances, strict=True)}
        worst = -np.inf
        for (a, b), d in zip(reached.tolist(), after, strict=True):
            before = earlier.get((a, b), np.inf)
            if before >= self._d_min or (a, b) in self._kept:
                before = min(before, self._d_min)
                worst = max(worst, before - d - DEEP * max(-before, 0.0))
        found["distance"] = worst
        return found

    def _closing(self, moment: Moment, step: Step) -> dict[str, float]:
        """Return how far MuJoCo's own constraints are from J v = −K r, in what v can do about it.

        It is the part of the difference that lies in the range of J, relative to the rates.
        """
        loop, flags, model, data = self._loop, step.flag_bits, self._model, self._data
        given_up = (Status.RELAXED, Status.MAX_ITER, Status.DEADLINE)
        if loop is None or any(flags >> status & 1 for status in given_up) or moment.mocap[2].any():
            return {}
        self._move_to(moment.q, *moment.mocap[:2])
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)
        ids = [model.equality(name).id for name in loop.equalities or range(model.neq)]
        meant = np.isin(data.efc_id[: data.ne], ids)
        jacobian = np.zeros((data.ne, model.nv))
        if mujoco.mj_isSparse(model):
            counts, starts = data.efc_J_rownnz[: data.ne], data.efc_J_rowadr[: data.ne]
            mujoco.mju_sparse2dense(jacobian, data.efc_J, counts, starts, data.efc_J_colind)
        else:
            jacobian[:] = data.efc_J[: jacobian.size].reshape(jacobian.shape)
        gain = np.inf if loop.gain == "deadbeat" else loop.gain
        rates = min(gain, 1.0 / moment.dt) * data.efc_pos[: data.ne][meant]
        free = self._contract.moves & (self._contract.velocity > 0.0)
        left, sigma, _ = np.linalg.svd(jacobian[np.ix_(meant, free)], full_matrices=False)
        left = left[:, sigma > RANK * sigma.max(initial=1.0)]
        missed = np.linalg.norm(left.T @ (jacobian[meant] @ step.v + rates))
        return {"loop": float(missed / max(1.0, np.linalg.norm(rates)))}

    def _move_to(self, q: Array, position: Array, quaternion: Array) -> None:
        data = self._data
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = q, position, quaternion
        mujoco.mj_kinematics(self._model, data)
        if self._speeds:
            mujoco.mj_comPos(self._model, data)

    def _speed(self, v: Array) -> float:
        """Return by how much frames are faster than they may be at the present configuration."""
        jacobian, worst = np.zeros((6, self._model.nv)), -np.inf
        for frame, limit in self._speeds:
            kinds = {
                "site": mujoco.mj_jacSite,
                "body": mujoco.mj_jacBody,
                "geom": mujoco.mj_jacGeom,
            }
            assert frame.kind is not None
            of = getattr(self._model, frame.kind)(frame.name).id
            kinds[frame.kind](self._model, self._data, jacobian[:3], jacobian[3:], of)
            speeds = np.linalg.norm((jacobian @ v).reshape(2, 3), axis=1).tolist()
            for speed, largest in zip(speeds, (limit.linear, limit.angular), strict=True):
                if largest is not None:
                    worst = max(worst, (speed - largest) / max(1.0, largest))
        return float(worst)

    def _heights(self) -> Array:
        """Return how far the frames are in front of their planes."""
        heights = []
        for plane in self._planes:
            assert plane.frame.kind is not None
            of = getattr(self._data, plane.frame.kind)(plane.frame.name)
            normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
            heights.append(normal @ of.xpos - plane.offset)
        return np.array(heights)

    def _angles(self) -> Array:
        """Return by how much ball joints are turned further than they may be."""
        over = []
        for joint, largest in self._contract.balls:
            first = self._model.jnt_qposadr[joint]
            w, *vector = self._data.qpos[first : first + 4]
            over.append(2.0 * np.arctan2(np.linalg.norm(vector), abs(w)) - largest)
        return np.array(over)

    def _distances(self) -> tuple[Pairs, Array]:
        """Return the pairs (k, 2) that may be nearer than d_min, and their distances (k,)."""
        if not self._pairs.size:
            return self._pairs, np.zeros(0)
        centres = self._data.geom_xpos[self._pairs]
        apart = np.linalg.norm(centres[:, 1] - centres[:, 0], axis=1)
        pairs = self._pairs[~(apart - self._near > self._d_min)]
        return pairs, np.array([self._distance(a, b) for a, b in pairs.tolist()])

    def _distance(self, a: int, b: int) -> float:
        kinds = (int(self._model.geom_type[a]), int(self._model.geom_type[b]))
        if kinds == (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX):
            return self._capsule_to_box(a, b)
        return mujoco.mj_geomDistance(self._model, self._data, a, b, 2.0 * self._d_min + 0.1, None)

    def _capsule_to_box(self, capsule: int, box: int) -> float:
        """Return the least distance of the capsule's axis from the box, less the radius.

        A convex function along the axis, found by narrowing: MuJoCo's own answer is wrong where the
        axis passes through the box, and this one no more than the depth of the axis there.
        """
        model, data = self._model, self._data
        radius, half = model.geom_size[capsule, :2]
        turn = data.geom_xmat[box].reshape(3, 3)
        centre = turn.T @ (data.geom_xpos[capsule] - data.geom_xpos[box])
        along = turn.T @ data.geom_xmat[capsule].reshape(3, 3)[:, 2]
        low, high, least = -half, half, np.inf
        for _ in range(6):
            t = np.linspace(low, high, 33)
            outside = np.abs(centre + t[:, None] * along) - model.geom_size[box]
            d = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(1), 0.0)
            k = int(np.argmin(d))
            least, low, high = float(d[k]), t[max(k - 1, 0)], t[min(k + 1, 32)]
        return least - float(radius)

    def _optimum(self, step: Step, controller: rmrc.Controller) -> dict[str, float]:
        """Return the residuals beyond what a trusted solution may have, unless it says so."""
        if step.flag_bits >> Status.MAX_ITER & 1 or step.flag_bits >> Status.DEADLINE & 1:
            return {}
        solution, qp = step.solution, controller.engine.assembly.qp
        unit = max(1.0, float(np.linalg.norm(qp.g)))
        primal, dual, complementarity = solution.kkt
        found = {"certificate": max(primal, dual / unit, complementarity / unit)}
        if solution.status is not SolveStatus.SOLVED:
            found["certificate"] = np.inf
        if not step.flag_bits >> Status.RELAXED & 1:
            found["equality"] = float(np.abs(qp.E @ solution.v - qp.f).max(initial=0.0))
            # Where a frame's speed is at its limit the program had the ball's curvature in H.
            bent = bool(self._speeds) and bool(solution.row_multiplier.any())
            if self._certified and step.moment.share == 1.0 and not bent:
                found["residual"] = _residual(qp, solution, unit)
        return found


def _pairs_of(barrier: object) -> list[tuple[int, int]]:
    """Return the pairs of geoms that a compiled limit is about, if it is about such."""
    geoms = getattr(barrier, "geoms", None)
    return [] if geoms is None else [(int(a), int(b)) for a, b in geoms]


ROUNDED = 1e-12
"""Share of the parts of a sum that rounding leaves of it where they cancel."""


def _residual(qp: QP, solution: Solution, unit: float) -> float:
    """Return the largest residual of the optimality conditions of a program at a solution."""
    v, z, y, w = (
        solution.v,
        solution.bound_multiplier,
        solution.row_multiplier,
        solution.equality_multiplier,
    )
    ends = ((v, qp.lb, qp.ub, z), (qp.C @ v, qp.lo, qp.hi, y))
    primal = float(np.abs(qp.E @ v - qp.f).max(initial=0.0))
    parts = (qp.H @ v, qp.g, z, qp.C.T @ y, qp.E.T @ w)
    dual = float(np.linalg.norm(sum(parts)))
    dual = max(0.0, dual - ROUNDED * sum(float(np.linalg.norm(part)) for part in parts))
    slackness = 0.0
    for x, lower, upper, multiplier in ends:
        primal = max(primal, float(np.maximum(lower - x, x - upper).max(initial=0.0)))
        room = np.where(multiplier > 0.0, upper - x, x - lower) - ROUNDED * np.abs(x)
        room = np.maximum(room, 0.0)
        limited = (multiplier != 0.0) & np.isfinite(room)
        slackness += float(np.abs(multiplier[limited]) @ room[limited])
        dual = max(dual, float(np.abs(multiplier[~np.isfinite(room)]).max(initial=0.0)))
    return max(primal, dual / unit, slackness / unit)
