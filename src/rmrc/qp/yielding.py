"""What gives way near a singularity: hard tasks, directions, and levels below."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.problem import Problem
from rmrc.qp.cascade import Level
from rmrc.qp.curvature import Curvature
from rmrc.qp.equalities import Equalities
from rmrc.qp.program import QP
from rmrc.qp.relax import INCONSISTENT
from rmrc.tasks.base import Term, square_root

Array = NDArray[np.float64]

SPARED = 0.005
"""Share of what a level gains that lower ones may cost it where it cannot have more."""
WEAK = 0.02
"""Share of ‖J‖ ‖v‖ that a motion for ẋ must give: less is a singularity, where it swings."""
RESOLVED = 1e-12
"""Share of the largest element of W Wᵀ that rounding leaves its least eigenvalue."""
SLIGHT = 1e-12
"""A shorter v is rounding, rad/s or m/s."""
AT_BOUND = 1e-7
"""A rate this close to its bound is at it, rad/s or m/s."""


class Yielding:
    """Sees to it that what no cost draws does not keep the robot from its rest.

    An equality J v = ẋ, a preserved direction and the null space of a level do not see X. Near a
    singularity they have the joints swing about the place that V draws them to. There a hard task
    is a cost above all others, a direction is a cost like any other, and lower levels leave the
    one above most of what it gains. It is for targets at rest.
    """

    def __init__(
        self,
        problem: Problem,
        curvature: Curvature,
        leveled: Callable[[Term], Array],
        levels: Sequence[Sequence[Term]],
        rate: Array,
        qp: QP,
    ):
        evaluation = curvature.evaluation
        self._evaluation, self._curvature, self._leveled = evaluation, curvature, leveled
        self._levels, self._rate, self._qp = levels, rate, qp
        self._dofs, self._fastest = problem.dofs, problem.box.velocity
        gained = [np.full(term.rows, term.gain > 0.0) for term in evaluation.terms]
        self._gained = np.concatenate([*gained, np.zeros(0, dtype=np.bool_)])
        hard = [term for term in evaluation.terms if term.hard]
        self.bending = [term for term in hard if term in curvature.exact]
        """The hard tasks that may be a cost."""
        firm = [term for term in hard if term not in curvature.exact]
        self._all = Equalities(problem, evaluation, hard) if hard else None
        self._firm = Equalities(problem, evaluation, firm) if firm else None
        self.softened = False
        """Whether they are one at this step."""
        self.dt = problem.dt
        """Length of the present step, s."""

    @property
    def still(self) -> bool:
        """Whether no target that a task has a gain for moves."""
        return not self._evaluation.feedforward[self._gained].any()

    def held(self, lower: Array) -> Equalities | None:
        """Return the equalities of the present step, with the bounds lb (n,); None without any."""
        self.softened = False
        if self._all is None:
            return None
        self._all.update(self._rate, lower)
        self.softened = self._cannot_hold(self._all)
        if not self.softened:
            return self._all
        if self._firm is not None:
            self._firm.update(self._rate, lower)
        return self._firm

    def _cannot_hold(self, held: Equalities) -> bool:
        """Return whether E v = f has no v, or one at which V may rise, cut to the velocity limits.

        Nor does it hold near a singularity, where the joints rush and what they move hardly moves.
        """
        if not (self.bending and self.still):
            return False
        v = held.least_norm
        if held.inconsistency > INCONSISTENT or self._is_weak(self.bending, v):
            return True
        moves = self._fastest > 0.0
        faster = float((np.abs(v[moves]) / self._fastest[moves]).max(initial=1.0))
        return self._curvature.passes(self.bending, v / faster, self._rate, self.dt)

    def turns_back(self, directed: Sequence[Array | None]) -> bool:
        """Return whether V may rise for what preserves its direction, at the v (n,) that it takes.

        That is v of each level without what its other tasks add, which says nothing of a direction.
        Nor is a direction kept near a singularity, where its joints rush and it hardly moves.
        """
        if not self.still:
            return False
        first = 1 if self.softened else 0
        for terms, v in zip(self._levels, directed[first:], strict=False):
            preserved = [t for t in terms if t.preserve and t in self._curvature.exact]
            if not preserved or v is None or float(np.linalg.norm(v)) < SLIGHT:
                continue
            if self._curvature.passes(preserved, v, self._rate, self.dt):
                return True
            if self._is_weak(preserved, v):
                return True
        return False

    def _is_weak(self, terms: Sequence[Term], v: Array) -> bool:
        """Return whether terms that no cost draws hardly move at v (n,): ‖J v‖ < 0.02 ‖J‖ ‖v‖."""
        rows = np.vstack([self._exact_rows(term)[0] for term in terms])
        return bool(np.linalg.norm(rows @ v) < WEAK * np.linalg.norm(rows) * np.linalg.norm(v))

    def bound(self, terms: Sequence[Term]) -> Array:
        """Return X (n, n) of terms that no cost draws."""
        return np.diag(self._curvature.bound(terms, self._rate, self.dt))

    def level(self, damping: Array) -> Level:
        """Return the hard tasks that bend as a level, with X and a damping (n, n)."""
        rows, rates = zip(*map(self._exact_rows, self.bending), strict=True)
        return Level(np.vstack(rows), np.concatenate(rates), damping + self.bound(self.bending))

    def misses(self, v: Array) -> float:
        """Return by how much v (n,) misses what is asked of the hard tasks that bend."""
        missed = [rows @ v - rate for rows, rate in map(self._exact_rows, self.bending)]
        return float(np.linalg.norm(np.concatenate(missed)))

    def spare(self, levels: list[Level], optima: list[Array]) -> Array:
        """Return v (n,) with less of what lower levels cost those above where those are singular.

        With v_k the optimum of level k, what lower ones do in its null space, u = v − v_k, costs it
        ½ dt uᵀCu, with C of what it cannot get, m = dt² (W Wᵀ + dt²)⁻¹ (S ẋ − W v_k) for the joints
        that are not at their bounds. u is cut to where dt uᵀCu ≤ 0.005 (S ẋ)ᵀ W (v_k − v_k−1).

        Args:
            levels: What they ask for, that of the softened hard tasks first.
            optima: v_k (n,) of each level that was solved.
        """
        parts = [*([self.bending] if self.softened else []), *self._levels]
        v, dt = optima[-1], self.dt
        befores = [np.zeros(self._dofs.size), *optima]
        steps = list(zip(parts, levels, optima[:-1], befores, strict=False))
        for terms, level, at, before in reversed(steps):
            free = (at > self._qp.lb + AT_BOUND) & (at < self._qp.ub - AT_BOUND)
            columns, missed = level.rows[:, free], level.rate - level.rows @ at
            gram = columns @ columns.T
            damping = max(dt**2, RESOLVED * float(gram.diagonal().max(initial=0.0)))
            missed = damping * np.linalg.solve(gram + damping * np.eye(missed.size), missed)
            gained, cost, first = float(level.rate @ (level.rows @ (at - before))), 0.0, 0
            for term in terms:
                root = self.root(term)
                rows = slice(first, first + len(root))
                if term in self._curvature.ways:
                    cost += dt * self._curvature.bent(term, root.T @ missed[rows], v - at)
                first = rows.stop
            spared = max(0.0, SPARED * gained)
            if cost > spared:
                v = at + math.sqrt(spared / cost) * (v - at)
        return v

    def root(self, term: Term) -> Array:
        """Return S (r, rows) of a term as the levels have it, B = SᵀS."""
        softened = term.hard and term in self._curvature.exact
        root = _full_root(self._curvature.exact[term] if softened else self._leveled(term))
        return root[np.any(root != 0.0, axis=1)] if term.joint else root

    def _exact_rows(self, term: Term) -> tuple[Array, Array]:
        """Return S J (r, n) and S ẋ (r,) of a term that no cost draws, for what of it counts."""
        part, root = self._evaluation.rows_of([term]), _full_root(self._curvature.exact[term])
        return root @ self._evaluation.jacobian[part][:, self._dofs], root @ self._rate[part]


def _full_root(weight: Array) -> Array:
    """Return S (rows, rows) with B = SᵀS."""
    root = square_root(weight)
    return np.diag(root) if root.ndim == 1 else root
