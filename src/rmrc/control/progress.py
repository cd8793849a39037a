"""Whether the robot rests without being there: `STUCK`."""

import math

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.tasks.base import Term

Array = NDArray[np.float64]

REST = 1e-3
"""The robot rests where no joint is faster, rad/s or m/s."""
WINDOW = 0.25
"""Time for which it has to rest, s: joints that turn round or set off are slow for less."""
SHARE = 1e-3
"""Share of the speed that is asked for below which there is no progress."""
TOLERANCES = 0.1
"""Tolerances a second below which there is no progress."""


class Progress:
    """Watches the decisive tasks of the highest level.

    They are stuck where, for a quarter of a second up to this step, an error is above its
    tolerance, no joint moves to speak of, and ‖e‖_B falls by less than a tenth of the tolerance a
    second and less than a thousandth of the speed asked for, eᵀB J v < 10⁻³ eᵀB ẋ: a gain that is
    slow is no want of progress.
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
        weights = [term.diagonal for term, _, _ in self._terms]
        self._weight = np.concatenate([*weights, np.zeros(0)])
        tolerances = [_row_tolerances(term, limit) for term, _, _ in self._terms]
        self.tolerance = math.sqrt(
            float(self._weight @ np.concatenate([*tolerances, np.zeros(0)]) ** 2)
        )
        """‖tolerances‖_B."""
        self.reset()

    def reset(self) -> None:
        """Forget what was."""
        self.stuck = False
        self._rested = 0.0

    def update(self, v: Array, dt: float) -> None:
        """Take note of a command v (n,) for a step of dt at the present evaluation."""
        if not self._terms:
            return
        rests = bool(np.abs(v).max() <= REST) and self._is_off() and self._stays(v)
        self._rested = self._rested + dt if rests else 0.0
        self.stuck = self._rested >= WINDOW

    def _stays(self, v: Array) -> bool:
        """Return whether v (n,) brings the tasks no nearer."""
        evaluation, rows = self._evaluation, self._rows
        error = evaluation.error[rows]
        pull = self._weight * error
        length = math.sqrt(max(pull.dot(error), 0.0))
        asked = pull.dot(self._assembly.rate[rows])
        speed = pull.dot(evaluation.jacobian[rows])[self._dofs].dot(v)
        return bool(speed < min(TOLERANCES * self.tolerance * length, SHARE * asked))

    def _is_off(self) -> bool:
        """Return whether an error is above its tolerance."""
        return any(
            (term.measure(self._evaluation.error[part]) > limits).any()
            for term, part, limits in self._terms
        )

    def watched(self) -> list[tuple[Term, Array, tuple[float, float]]]:
        """Return the decisive tasks, B's diagonal, and the distance and angle that count as there.

        One that a task does not measure is infinite.
        """
        found = []
        for term, _, limits in self._terms:
            by_unit = dict(zip(term.units, limits.tolist(), strict=True))
            pair = (by_unit.get("m", math.inf), by_unit.get("rad", math.inf))
            found.append((term, term.diagonal, pair))
        return found


def _run(indices: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return indices as the slice that they are, if they are one: it needs no copy."""
    if indices.size and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


def _row_tolerances(term: Term, limit: dict[str, float]) -> Array:
    """Return the tolerance of each row: those of a vector together make that of its norm."""
    tolerances = np.zeros(term.rows)
    for unit, rows in zip(term.units, term.unit_rows, strict=True):
        tolerances[rows] = limit[unit] / math.sqrt(rows.size)
    return tolerances
