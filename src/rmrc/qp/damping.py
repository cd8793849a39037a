"""The damping λ of a step: its floor, and what a singularity or a large error adds to it."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.tasks.base import Term

Array = NDArray[np.float64]

SAMPLES = 8
"""Configurations that the rank of W is found from."""
RANK = 1e-6
"""Share of σ₁ up to which a singular value is none: the root of a matrix B, taken from its
eigenvalues, leaves about 1e-8 where B has no weight."""
RAISED = 1e-6
"""Share of λ² that what is added to the floor has to exceed to count."""


def largest_square(problem: Problem) -> float:
    """Return the largest λ² that a problem's damping can have."""
    model = problem.config.damping
    return problem.damping**2 + (model.largest**2 if model.adapt != "off" else 0.0)


class Damping:
    """λ² = λ₀² + λ_a² at the present configuration, with the floor λ₀ and, by `adapt`,

        sigma_min       λ_a² = λ_max² (1 − (σ/ε)²)  where σ < ε, otherwise 0
        manipulability  λ_a² = λ_max² (1 − w/w₀)²   where w < w₀, otherwise 0
        error           λ_a² = min(½ eᵀBe, λ_max²)

    over the tasked rows: those with a weight of the highest level that has any, W = S J, B = SᵀS,
    and the columns of the dofs that may move, in the configuration's own unit and without the share
    of a soft level. Hard tasks, tasks on the joints themselves and tasks of mink's have no part in
    it. σ = σ_r and w = σ₁ … σ_r, where r is the rank that W has at almost every configuration:
    rows that no motion can serve (z of a planar arm, the roll of an axis that is aligned), and dofs
    that a task leaves free, are not what is singular.

    All joints are damped alike: ‖v‖ ≤ √(Σ ẋᵀBẋ)/2λ over all the terms then holds inside any limits
    that allow rest, and v is continuous in q. Damping the right singular vector of σ_r
    alone, or the row space of W, would leave posture and lower levels their speed; but where a
    redundant arm is singular that vector has no limit. Next to it it turns by 180° within a step,
    and what is left to the posture turns with it (planar 3R, 1e-5 rad from stretched, 1 kHz: jumps
    of 0.25 rad/s, where damping all joints alike changes v by 0.006).

    In `error`, e and not ẋ counts, so that the gain does not: with it v is the flow of Sugihara's
    iteration, K times its step. The cap keeps a target far away from bringing the robot to rest.

    Source: Chiaverini 1997; Nakamura and Hanafusa 1986; Sugihara 2011; see `rmrc.reference`.
    """

    def __init__(
        self, problem: Problem, evaluation: Evaluation, weigh: Callable[[], Array], unit: float
    ):
        self._problem, self._evaluation, self._model = problem, evaluation, problem.config.damping
        tasked = _highest(
            [t for t in evaluation.terms if not (t.joint or t.hard) and t.weight.any()]
        )
        rows = [evaluation.rows_of([t]).start + np.flatnonzero(_weighed(t)) for t in tasked]
        self.rows = np.concatenate(rows) if rows else np.zeros(0, dtype=np.intp)
        """The tasked rows, among those of all terms."""
        self._errors = [(evaluation.error_of(evaluation.error, t), t.weight) for t in tasked]
        share = problem.soft_ratio ** tasked[0].level if tasked else 1.0
        self.scale = 1.0 / math.sqrt(unit * share)
        """What turns W into the configuration's own unit."""
        self._weighted = weigh()
        self.rank = self._generic_rank(weigh)
        """r."""
        raising = {
            "off": None,
            "sigma_min": self._by_sigma_min,
            "manipulability": self._by_manipulability,
            "error": self._by_error,
        }
        self._raise = raising[self._model.adapt] if self.rank else None
        self.adapts = self._raise is not None
        """Whether λ can rise above its floor at all."""
        self._floor = problem.damping**2
        self.added = np.zeros(1)
        """λ_a² of the last update (1,)."""

    def _generic_rank(self, weigh: Callable[[], Array]) -> int:
        """Return r, from configurations drawn around the start, where the evaluation is left."""
        evaluation, start, dofs = self._evaluation, self._problem.start, self._problem.dofs
        rng, rank = np.random.default_rng(0), 0
        for _ in range(SAMPLES if self.rows.size else 0):
            evaluation.move(start, dofs, rng.uniform(-np.pi, np.pi, dofs.size))
            weigh()
            sigma = self._all_singular_values()
            rank = max(rank, int(np.count_nonzero(sigma > RANK * sigma[0])))
        evaluation.move(start, dofs, np.zeros(dofs.size))
        return rank

    def _all_singular_values(self) -> Array:
        """Return those of W, the largest first; zeros where the decomposition fails."""
        rows = self._weighted.take(self.rows, 0).take(self._problem.dofs, 1)
        try:
            sigma = np.linalg.svd(rows, compute_uv=False)
        except np.linalg.LinAlgError:
            return np.zeros(min(rows.shape))
        return np.multiply(sigma, self.scale)

    def singular_values(self) -> Array:
        """Return σ₁ … σ_r of W (r,) at the last assembly, in the configuration's own unit."""
        return self._all_singular_values()[: self.rank] if self.rank else np.zeros(0)

    def update(self) -> float:
        """Find λ at the present W and errors; return λ_a²."""
        added = self._raise() if self._raise is not None else 0.0
        self.added[0] = added
        return added

    @property
    def square(self) -> float:
        """λ² at the last update."""
        return self._floor + self.added.item()

    @property
    def raised(self) -> bool:
        """Whether λ was above its floor at the last update, by more than rounding."""
        return self.added.item() > RAISED * self.square

    def _by_sigma_min(self) -> float:
        ratio = float(self.singular_values()[-1]) / self._model.threshold
        return self._model.largest**2 * max(0.0, 1.0 - ratio * ratio)

    def _by_manipulability(self) -> float:
        ratio = math.prod(self.singular_values().tolist()) / self._model.threshold
        return (self._model.largest * max(0.0, 1.0 - ratio)) ** 2

    def _by_error(self) -> float:
        square = sum(
            float(e.dot(weight * e if weight.ndim == 1 else weight @ e))
            for e, weight in self._errors
        )
        return min(0.5 * square, self._model.largest**2)


def _highest(terms: list[Term]) -> list[Term]:
    """Return the terms of the highest level among these."""
    level = min((term.level for term in terms), default=0)
    return [term for term in terms if term.level == level]


def _weighed(term: Term) -> Array:
    """Return an array (rows,) that is zero where S has no row, which a matrix B may have all."""
    return term.weight if term.weight.ndim == 1 else np.ones(term.rows)
