"""The curvature of the tasks as a diagonal of the program: with it the robot rests out of reach."""

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from rmrc.model.configuration import turning_dofs
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.tasks.base import BendingTerm, Pull, Term, Way

Array = NDArray[np.float64]

LEAST = 0.1
"""The least dt K in X with acceleration limits: no direction's gain is then far above K."""
LONGEST = 3.0
"""Times that the logarithm's own curvature makes C longer than X, where JᵀBJ does not cover it."""


class Curvature:
    """X, a diagonal with X ⪰ dt Σ K C⁺ for the curvature C = −Σ_r (B e)_r ∇²f_r of each task.

    Gauss and Newton's JᵀBJ leaves C out, and near full stretch there is nothing else. With X the
    optimum is a step of the linearly implicit Euler method on the flow of V = Σ K ½ eᵀBe, which
    stays where it is stable at any stiffness: V does not rise, and the robot comes to rest.

    A task pulls its frame with the force f and the torque τ, JᵀBKe = v_jᵀf + ω_jᵀτ for each dof j,
    where v_j and ω_j are the frame's velocities at its unit rate. For i before j on the way from
    the world to the frame

        C_ij = −ω_i · u_j  with  u_j = v_j × f + ½ ω_j × τ,

    which is at most ‖u_j‖ for a hinge i and 0 for a slide, and row sums bound what is symmetric
    (Gershgorin):

        X_ii = dt (Σ_{j at or after i} ‖u_j‖ + Σ_{j before i} ‖u_i‖).

    A force that turns about a point n away as the frame moves adds ‖v_i‖ ‖v_j‖ ‖f‖/n to |C_ij|.
    Where i is a hinge and j a slide their rates have two units: the two elements count as ‖u_j‖ L
    and ‖u_j‖/L, with L the model's extent. What the logarithm of a rotation or a unit vector bends
    beside this is inside the bound, as `tests/unit/qp/test_curvature.py` holds.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation, leveled: Callable[[Term], Array]):
        self.evaluation = evaluation
        model, dofs = problem.model, problem.dofs.tolist()
        self._column = {dof: k for k, dof in enumerate(dofs)}
        self._hinge = turning_dofs(model)
        self._unit = np.where(self._hinge, 1.0, model.stat.extent)
        bending = [t for t in evaluation.terms if isinstance(t, BendingTerm) and problem.curvature]
        self.ways: dict[Term, Way] = {term: term.way(model).within(dofs) for term in bending}
        """The ways of the terms that bend."""
        self.exact: dict[Term, Array] = {t: _mask(t) for t in bending if t.hard or t.preserve}
        """What of the rows counts of those that no cost draws."""
        self._weights = {t: leveled(t) for t in bending if t not in self.exact}
        self.least = LEAST if np.isfinite(problem.box.acceleration).any() else 0.0
        """The least dt K in X."""
        self.levels = {term.level: np.zeros(len(dofs)) for term in self._weights}
        """X (n,) of each level at the last update, in the program's unit."""

    def update(self, rate: Array, dt: float) -> None:
        """Find X at ẋ without its feed-forward, K clamp(e) (rows,) of all terms."""
        for diagonal in self.levels.values():
            diagonal[:] = 0.0
        for term, weight in self._weights.items():
            self._add(term, weight, rate, dt, self.levels[term.level])

    def bound(self, terms: Iterable[Term], rate: Array, dt: float) -> Array:
        """Return X (n,) of terms that no cost draws, at K clamp(e) (rows,) of all terms."""
        diagonal = np.zeros(len(self._column))
        for term in terms:
            self._add(term, self.exact[term], rate, dt, diagonal)
        return diagonal

    def passes(self, terms: Iterable[Term], v: Array, rate: Array, dt: float) -> bool:
        """Return whether V may rise where some terms get v (n,), what they ask for exactly.

        So it may where Σ dt K (J v)ᵀB(J v) + 3 vᵀXv > 2 bᵀv, with b = Σ JᵀBKe: near a singularity
        J v = ẋ goes as far as the limits let it, first to one side and then to the other.
        """
        drawn, curved = 0.0, LONGEST * float(self.bound(terms, rate, dt) @ (v * v))
        for term in terms:
            moved = self._moved(term, v)
            weight = self.exact[term]
            drawn += float(_weighed(weight, self.evaluation.error_of(rate, term)) @ moved)
            curved += dt * min(term.gain, 1.0 / dt) * float(moved @ _weighed(weight, moved))
        return curved > 2.0 * drawn

    def bent(self, term: Term, pulled: Array, u: Array) -> float:
        """Return uᵀCu at B x (rows,) of a term: −Σ_j u_j m_j · (2 Ω_j + ω_j u_j).

        m_j is the u_j of the class, and Ω_j how fast the dofs before j turn the frame.
        """
        way = self.ways[term]
        (linear, angular, force, _, distance), moments = self._pull(term, pulled)
        turned, total, along = np.zeros((len(way.dofs), 3)), 0.0, np.zeros(3)
        for k, (dof, before) in enumerate(zip(way.dofs, way.before, strict=True)):
            rate = u[self._column[dof]]
            own = angular[:, dof] * rate if self._hinge[dof] else np.zeros(3)
            ahead = turned[before] if before >= 0 else np.zeros(3)
            total -= rate * float(moments[dof] @ (2.0 * ahead + own))
            turned[k] = ahead + own
            along += linear[:, dof] * rate
        if distance < math.inf:
            total += float(np.linalg.norm(force) / distance * (along @ along))
        return total

    def _pull(self, term: Term, pulled: Array) -> tuple[Pull, Array]:
        """Return the pull of a term at B x (rows,), and u_j (nv, 3) of it."""
        assert isinstance(term, BendingTerm)
        pull = term.pull(self.evaluation, pulled)
        linear, angular, force, torque, _ = pull
        return pull, np.cross(linear.T, force) + 0.5 * np.cross(angular.T, torque)

    def _moved(self, term: Term, v: Array) -> Array:
        """Return J v (rows,) of a term."""
        rows = self.evaluation.rows_of([term])
        return self.evaluation.jacobian[rows][:, list(self._column)] @ v

    def _add(self, term: Term, weight: Array, rate: Array, dt: float, diagonal: Array) -> None:
        """Add dt or the least of it times the row sums of |C| for B ẋ to a diagonal (n,)."""
        time = max(dt, self.least * max(1.0 / term.gain, dt))
        pulled = time * _weighed(weight, self.evaluation.error_of(rate, term))
        (linear, _, force, _, distance), moments = self._pull(term, pulled)
        self._add_row_sums(np.linalg.norm(moments, axis=1), self.ways[term], diagonal)
        if distance < math.inf:
            levers = np.linalg.norm(linear, axis=0)[list(self._column)]
            diagonal += np.linalg.norm(force) / distance * levers.sum() * levers

    def joints(self, way: Way) -> list[tuple[int, int, bool, float]]:
        """Return each dof on a way, the place before it, whether it turns, and its unit."""
        return [
            (dof, before, bool(self._hinge[dof]), float(self._unit[dof]))
            for dof, before in zip(way.dofs, way.before, strict=True)
        ]

    def _add_row_sums(self, moment: Array, way: Way, sums: Array) -> None:
        """Add the sums over the rows of |C| for ‖u_j‖ (nv,), from the frame back to the world."""
        hinges, after = np.zeros(len(way.dofs)), np.zeros(len(way.dofs))
        for k, (dof, before) in enumerate(zip(way.dofs, way.before, strict=True)):
            hinges[k] = hinges[before] + self._hinge[way.dofs[before]] if before >= 0 else 0.0
            sums[self._column[dof]] += hinges[k] * moment[dof] / self._unit[dof]
        for k, (dof, before) in reversed(list(enumerate(zip(way.dofs, way.before, strict=True)))):
            after[k] += moment[dof] * self._unit[dof]
            if self._hinge[dof]:
                sums[self._column[dof]] += after[k]
            if before >= 0:
                after[before] += after[k]


def _weighed(weight: Array, x: Array) -> Array:
    return weight * x if weight.ndim == 1 else weight @ x


def _mask(term: Term) -> Array:
    """Return 1 for the rows that a term without a cost means; a full B as it is."""
    weight = term.weight
    return (weight > 0.0).astype(float) if weight.ndim == 1 else weight / np.abs(weight).max()
