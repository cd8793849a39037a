"""Whether the tasks still get on: `STUCK` comes from progress, not from a velocity."""

import math

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.problem.tasks.base import Term
from rmrc.qp.assemble import Assembly

Array = NDArray[np.float64]

WINDOW = 0.25
"""Time without progress after which the tasks are stuck, s."""
LOOKS = 10
"""Looks at the progress in that time."""
SHARE = 1e-3
"""Share of the speed that is asked for below which there is no progress."""
TOLERANCES = 0.1
"""Tolerances a second below which there is no progress."""


class Progress:
    """Watches the speed p = eᵀB J v / ‖e‖_B at which the decisive tasks approach their targets.

    They are stuck where an error is above its tolerance and p is below a tenth of the tolerance a
    second and a thousandth of the speed asked for, eᵀB ẋ / ‖e‖_B, for a quarter of a second. Joint
    rates that move nothing on are no progress; a slow gain is no want of it.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation, assembly: Assembly):
        self._evaluation, self._assembly, self._dofs = evaluation, assembly, _run(problem.dofs)
        tolerance = problem.config.tolerance
        limit = {"m": tolerance.position, "rad": tolerance.orientation}
        self._terms = [
            (term, evaluation.rows_of([term]), np.array([limit[unit] for unit in term.units]))
            for term in problem.terms
            if term.decisive and not term.joint and term.level == 0
        ]
        parts = [np.arange(part.start, part.stop) for _, part, _ in self._terms]
        self._rows = _run(np.concatenate([*parts, np.zeros(0, np.intp)]).astype(np.intp))
        weights = [_diagonal(term) for term, _, _ in self._terms]
        self._weight = np.concatenate([*weights, np.zeros(0)])
        tolerances = [_row_tolerances(term, limit) for term, _, _ in self._terms]
        self._tolerance = math.sqrt(
            float(self._weight @ np.concatenate([*tolerances, np.zeros(0)]) ** 2)
        )
        self.reset()

    def reset(self) -> None:
        """Forget what was."""
        self._since_look = self._without = 0.0
        self.stuck = False

    def update(self, v: Array, dt: float) -> None:
        """Take note of a command v (n,) for a step of dt at the present evaluation."""
        self._since_look += dt
        if self._since_look * LOOKS < WINDOW or not self._terms:
            return
        elapsed, self._since_look = self._since_look, 0.0
        self._without = self._without + elapsed if self._stands(v) else 0.0
        self.stuck = self._without >= WINDOW

    def _stands(self, v: Array) -> bool:
        evaluation, rows = self._evaluation, self._rows
        error = evaluation.error[rows]
        pull = self._weight * error
        length = math.sqrt(max(pull.dot(error), 0.0))
        if length == 0.0:
            return False
        asked = pull.dot(self._assembly.rate[rows]) / length
        slope = pull.dot(evaluation.jacobian[rows])[self._dofs]
        if not slope.dot(v) / length < min(TOLERANCES * self._tolerance, SHARE * asked):
            return False
        return any(
            (term.measure(evaluation.error[part]) > limits).any()
            for term, part, limits in self._terms
        )


def _run(indices: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return indices as the slice that they are, if they are one: it needs no copy."""
    if indices.size and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


def _diagonal(term: Term) -> Array:
    return term.weight if term.weight.ndim == 1 else np.diagonal(term.weight)


def _row_tolerances(term: Term, limit: dict[str, float]) -> Array:
    """Return the tolerance of each row: those of a vector together make that of its norm."""
    if term.rows == 6:
        return np.repeat([limit["m"], limit["rad"]], 3) / math.sqrt(3.0)
    return np.full(term.rows, limit[term.units[0]] / math.sqrt(term.rows))
