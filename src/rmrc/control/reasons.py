"""Why the robot rests without being there: out of reach, held back, or blocked."""

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.control.context import Moment
from rmrc.control.joint_bounds import JointBounds
from rmrc.control.progress import REST
from rmrc.control.status import ACTIVE_MULTIPLIER
from rmrc.limits.pairs import BETWEEN
from rmrc.qp.backends import create
from rmrc.qp.program import QP, Solution
from rmrc.tasks.base import Term

Array = NDArray[np.float64]

ATTEMPTS = 60
"""Steps of what a task would do by itself."""
GENTLE = 1e-3
"""Levenberg's damping at the first of them, a share of the largest element of JᵀBJ."""
HARSHER, GENTLER = 5.0, 0.2
"""What multiplies it after a step that V rises in, and one that it falls in."""
HARSHEST = 1e9
"""At this share there is no step that V falls in."""
FLAT = 1e-6
"""Share of V by which it falls no more."""
HALF = 0.5
"""Share of the tolerance that is worth naming what takes it."""
WORTH = 0.1
"""What counts: a share of the error that a release would give back, of what holds a task back, and
of the largest error of a pose, in tolerances."""
TURNED = 0.5
"""Share of the error of a position that another orientation would give back, to be the reason."""
STANDING = ("position", "freeze")
"""The limits of a joint that hold it where it is; those on its rate and its acceleration do not."""
ROUNDING = 1e-9
"""What keeps the balance of limits that press alike definite."""
CLOSE = 1e-4
"""A distance this near to the least, m or rad, has a part in what shortened a command."""


@dataclass(frozen=True)
class Reason:
    """Why one task is not there, and what would help."""

    task: str
    what: str
    """As "out of reach by 0.23 m"."""
    remedy: str
    """As "bring the target 0.23 m nearer"."""

    def __str__(self) -> str:
        return f"{self.task}: {self.what}; {self.remedy}"


class _Holder(NamedTuple):
    """What pulls the other way, and its pull on the joints (n,)."""

    what: str
    remedy: str
    pull: Array


def reasons(moment: Moment, solution: Solution) -> tuple[Reason, ...]:
    """Return why each decisive task is not within its tolerance, at a step at rest.

    Where a task comes no nearer by itself, without other tasks and limits, by Levenberg's method on
    V = ½ eᵀBe, its target is out of reach. Else something balances its pull f = JᵀBe: each of the
    pulls r of other tasks and of limits has the share −rᵀf / fᵀf in that. Those of the limits that
    leave no way are what comes nearest to the balance with the right signs.

    The engine has to be at the moment, and is there again afterwards.
    """
    problem = moment.engine.problem
    tolerance = {
        "m": problem.config.tolerance.position,
        "rad": problem.config.tolerance.orientation,
    }
    found: list[Reason] = []
    for term in problem.terms:
        if not (term.decisive and term.units and term.level == 0 and not term.joint):
            continue
        error = moment.engine.evaluation.error_of(moment.error, term)
        off = [
            (float(value), unit, tolerance[unit])
            for value, unit in zip(term.measure(error), term.units, strict=True)
            if value > tolerance[unit]
        ]
        if off:
            # Of a pose what is off beside what is far off makes room for it.
            most = max(value / limit for value, _, limit in off)
            decisive = [each for each in off if each[0] / each[2] >= WORTH * most]
            found += _Account(moment, solution, term).reasons(decisive)
    return tuple(found)


class _Account:
    """Why one task is not there."""

    def __init__(self, moment: Moment, solution: Solution, term: Term):
        self._moment, self._solution, self._term = moment, solution, term
        self._evaluation, self._assembly = moment.engine.evaluation, moment.engine.assembly
        self._dofs = moment.engine.problem.dofs
        self._bounds = JointBounds(moment)
        self._uncosted = term.hard or term.preserve
        weight = self._assembly.leveled(term)
        self._weight = (term.diagonal > 0.0).astype(float) if self._uncosted else weight

    def reasons(self, off: list[tuple[float, str, float]]) -> list[Reason]:
        """Return the reasons for errors with their units and tolerances."""
        alone = self._alone()
        left = [(alone[unit], unit) for _, unit, _ in off]
        gained = [(error - alone[unit], unit) for error, unit, _ in off]
        found: list[Reason] = []
        if any(
            g > max(HALF * each[2], WORTH * each[0])
            for (g, _), each in zip(gained, off, strict=True)
        ):
            found = self._held(_lengths(gained))
        if not found:
            left = [(error, unit) for error, unit, _ in off]
        if not found or any(e > each[2] for (e, _), each in zip(left, off, strict=True)):
            found += self._out_of_reach(left)
        return found

    def _out_of_reach(self, left: list[tuple[float, str]]) -> list[Reason]:
        """Return that the target is too far, or that a position is had at another orientation."""
        name, term = self._term.name, self._term
        position = {unit: error for error, unit in left}.get("m", 0.0)
        if position and "rad" in term.units:
            whole, rows = self._weight, np.zeros(term.rows)
            rows[term.unit_rows[term.units.index("m")]] = 1.0
            self._weight = rows * whole if whole.ndim == 1 else rows * whole * rows[:, None]
            alone = self._alone()["m"]
            self._weight = whole
            if position - alone > TURNED * position:
                by = _lengths([(position - alone, "m")])
                what = f"its orientation holds {name} back by {by}"
                remedy = f"turn the target, or give the orientation of {name} no weight in its B"
                near = [(alone, "m")] if alone > WORTH * position else []
                return [Reason(name, what, remedy), *([_too_far(name, near)] if near else [])]
        return [_too_far(name, left)]

    def _held(self, by: str) -> list[Reason]:
        """Return what holds the task back, the strongest first."""
        holders, pull = self._soft(), self._pull()
        holders += self._limits(pull + sum((h.pull for h in holders), np.zeros(pull.size)))
        shares = [-float(pull @ holder.pull) for holder in holders]
        found: dict[str, Reason] = {}
        for share, (what, remedy, _) in sorted(
            zip(shares, holders, strict=True), key=lambda each: -each[0]
        ):
            if share > WORTH * float(pull @ pull):
                text = what.format(by=by)
                found.setdefault(text, Reason(self._term.name, text, remedy))
        return list(found.values())

    def _pull(self) -> Array:
        """Return f = JᵀB clamp(e) (n,)."""
        error = self._evaluation.error_of(self._evaluation.error, self._term).copy()
        for part, longest in self._term.clamps:
            length = float(np.linalg.norm(error[part]))
            error[part] *= min(1.0, longest / length) if length > 0.0 else 1.0
        return self._jacobian().T @ self._weighed(error)

    def _jacobian(self) -> Array:
        return self._evaluation.jacobian[self._evaluation.rows_of([self._term])][:, self._dofs]

    def _weighed(self, x: Array) -> Array:
        """Return B x for x (rows, ...)."""
        return (self._weight * x.T).T if self._weight.ndim == 1 else self._weight @ x

    def _alone(self) -> dict[str, float]:
        """Return the errors by unit where the task gets to by itself, from here downhill."""
        evaluation, term, n = self._evaluation, self._term, self._dofs.size
        q, damping = self._moment.q.copy(), GENTLE

        def value() -> tuple[Array, float]:
            error = evaluation.error_of(evaluation.error, term).copy()
            return error, 0.5 * float(error @ self._weighed(error))

        error, least = value()
        normal, pull = self._normal(error)
        for _ in range(ATTEMPTS):
            scale = max(float(np.diagonal(normal).max()), 1e-300)
            tangent = np.zeros(evaluation.model.nv)
            tangent[self._dofs] = np.linalg.solve(normal + damping * scale * np.eye(n), pull)
            moved = q.copy()
            mujoco.mj_integratePos(evaluation.model, moved, tangent, 1.0)
            evaluation.update(moved)
            evaluation.evaluate()
            now, reached = value()
            if not reached < least:
                damping *= HARSHER
                if damping > HARSHEST:
                    break
                continue
            flat = least - reached < FLAT * least
            q, error, least, damping = moved, now, reached, damping * GENTLER
            normal, pull = self._normal(error)
            if flat:
                break
        evaluation.update(self._moment.q)
        evaluation.evaluate()
        return dict(zip(term.units, term.measure(error).tolist(), strict=True))

    def _normal(self, error: Array) -> tuple[Array, Array]:
        """Return JᵀBJ (n, n) and JᵀBe (n,) at the present evaluation."""
        jacobian = self._jacobian()
        return jacobian.T @ self._weighed(jacobian), jacobian.T @ self._weighed(error)

    def _soft(self) -> list[_Holder]:
        """Return the other tasks of the cost that may hold this one back."""
        problem, assembly, name = self._moment.engine.problem, self._assembly, self._term.name
        found = []
        for term in self._evaluation.terms:
            below = problem.strict and term.level > self._term.level
            if term is self._term or term.hard or term.preserve or self._uncosted or below:
                continue
            weight, rate = assembly.leveled(term), self._evaluation.error_of(assembly.rate, term)
            pulled = weight * rate if weight.ndim == 1 else weight @ rate
            if not term.joint:
                pulled = self._evaluation.jacobian[self._evaluation.rows_of([term])].T @ pulled
            gain = min(self._term.gain, 1.0 / self._moment.dt)
            remedy = f"raise B of {name}, or lower B of {term.name}"
            if term.level == self._term.level:
                remedy = f"{remedy}, or give {term.name} a lower level"
            found.append(
                _Holder(
                    f"{term.name} holds {name} back by {{by}}", remedy, pulled[self._dofs] / gain
                )
            )
        return found

    def _limits(self, rest: Array) -> list[_Holder]:
        """Return the limits that leave no way, with pulls that balance the rest (n,) best."""
        walls = self._walls()
        if not walls:
            return []
        normals = np.array([wall.pull for wall in walls]).T
        strengths = _balance(normals, rest)
        return [
            wall._replace(pull=strength * wall.pull)
            for wall, strength in zip(walls, strengths.tolist(), strict=True)
            if strength > 0.0
        ]

    def _walls(self) -> list[_Holder]:
        """Return the limits that leave no way, with the directions (n,) that they press in."""
        qp, solution, unit = self._assembly.qp, self._solution, np.eye(self._dofs.size)
        found = []
        z = solution.bound_multiplier
        for side, sign, near in (("upper", -1.0, qp.ub <= REST), ("lower", 1.0, qp.lb >= -REST)):
            held = np.flatnonzero(near | (-sign * z > ACTIVE_MULTIPLIER)).tolist()
            walls = ((self._bounds.kind(k, side), k) for k in held)
            found += [self._joint(k, kind, sign * unit[k]) for kind, k in walls if kind in STANDING]
        for term in self._evaluation.terms:
            if term.hard and term is not self._term:
                rows = self._evaluation.rows_of([term])
                jacobian = np.eye(qp.g.size) if term.joint else self._evaluation.jacobian[rows]
                weighed = (
                    jacobian[:, self._dofs][term.diagonal > 0.0] if not term.joint else jacobian
                )
                what, remedy = f"held back by {term.name}: it is hard", f"make {term.name} a cost"
                found += [
                    _Holder(what, remedy, sign * row) for row in weighed for sign in (1.0, -1.0)
                ]
        return found + self._rows()

    def _joint(self, k: int, kind: str, pull: Array) -> _Holder:
        name = self._bounds.name(k)
        if kind == "freeze":
            return _Holder(f"held back by {name}: it is frozen", f"let {name} move", pull)
        what = f"held back by {name}: its position limit"
        return _Holder(what, f"widen {name}'s range", pull)

    def _rows(self) -> list[_Holder]:
        """Return the rows that leave no way."""
        rows, qp = self._moment.engine.rows, self._assembly.qp
        near = np.maximum(rows.lower, -rows.upper) >= -REST
        y = self._solution.row_multiplier
        if y.size == near.size:
            near |= np.abs(y) > ACTIVE_MULTIPLIER
        if self._moment.share < 1.0:
            distances = [block.near.distance for block in rows.blocks]
            least = min((float(d.min()) for d in distances), default=0.0)
            for block, distance in zip(rows.blocks, distances, strict=True):
                near[block.rows] |= distance <= max(least, 0.0) + CLOSE
        found = []
        for k in np.flatnonzero(near).tolist():
            kind, name, lower, upper = self._moment.named_row(k)
            sign = 1.0 if lower >= -upper else -1.0
            pull = sign * qp.C[k] if qp.C.shape[0] == rows.count else sign * rows.matrix[k]
            if kind == "collision":
                remedy = "move the obstacle, or choose another way or start"
                found.append(_Holder(f"blocked by {name.replace(BETWEEN, ' and ')}", remedy, pull))
            else:
                remedy = f"widen that {kind} limit, or choose another way or start"
                found.append(_Holder(f"held back by {name}: its {kind} limit", remedy, pull))
        return found


def _balance(normals: Array, rest: Array) -> Array:
    """Return the s ≥ 0 (k,) for which N s + r is least, for N (n, k) and r (n,)."""
    qp = QP(normals.shape[1])
    scale = max(
        float(np.linalg.norm(rest)), 1e-300
    )  # the solver's tolerances are of numbers near 1
    np.add(normals.T @ normals, ROUNDING * np.eye(len(qp.g)), out=qp.H)
    qp.g[:], qp.lb[:], qp.ub[:] = normals.T @ rest / scale, 0.0, np.inf
    backend = create("daqp")
    backend.setup(qp)
    return scale * backend.solve().v


def _lengths(values: list[tuple[float, str]]) -> str:
    """Return lengths and angles as a person would say them."""
    return " and ".join(
        f"{1e3 * value:.2g} mm" if unit == "m" and value < 0.1 else f"{value:.2g} {unit}"
        for value, unit in values
    )


def _too_far(name: str, left: list[tuple[float, str]]) -> Reason:
    return Reason(name, f"out of reach by {_lengths(left)}", _nearer(left))


def _nearer(left: list[tuple[float, str]]) -> str:
    """Return what brings a target into reach."""
    verb = {"m": "bring", "rad": "turn"}
    return " and ".join(f"{verb[each[1]]} the target {_lengths([each])} nearer" for each in left)
