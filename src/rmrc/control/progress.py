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
"""Time over which progress is judged, s."""
LOOKS = 10
"""Looks at the errors in that time."""
SHARE = 1e-3
"""Share of the speed that is asked for below which there is no progress."""
TOLERANCES = 0.1
"""Tolerances a second below which there is no progress."""


class Progress:
    """Watches the error ‖e‖_B of the decisive tasks.

    They are stuck where an error is above its tolerance and the least ‖e‖_B of a quarter of a
    second is that of the quarter before, but for a tenth of the tolerance a second or a thousandth
    of the speed asked for, eᵀB ẋ / ‖e‖_B. Joint rates that move nothing on are no progress, nor is
    a joint that goes to and fro; a slow gain is no want of it, nor are joints that still turn
    round. Beside targets that move it is the speed of the approach, eᵀB J v / ‖e‖_B, that counts.
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
        self._since_look = 0.0
        self._targets = self._evaluation.targets.copy()
        self._before = math.inf
        self._begin()

    def _begin(self) -> None:
        """Begin a window."""
        self._elapsed, self._least, self._fastest = 0.0, math.inf, -math.inf
        self._still, self._moving = True, True  # whether targets never moved; whether they always

    def update(self, v: Array, dt: float) -> None:
        """Take note of a command v (n,) for a step of dt at the present evaluation."""
        self._since_look += dt
        if self._since_look * LOOKS < WINDOW or not self._terms:
            return
        elapsed, self._since_look = self._since_look, 0.0
        evaluation, rows = self._evaluation, self._rows
        error = evaluation.error[rows]
        pull = self._weight * error
        length = math.sqrt(max(pull.dot(error), 0.0))
        if not length > 0.0 or not self._is_off():
            self.reset()
            return
        asked = pull.dot(self._assembly.rate[rows]) / length
        speed = pull.dot(evaluation.jacobian[rows])[self._dofs].dot(v) / length
        self._elapsed += elapsed
        self._least, self._fastest = min(self._least, length), max(self._fastest, speed)
        moved = not np.array_equal(evaluation.targets, self._targets)
        self._still, self._moving = self._still and not moved, self._moving and moved
        self._targets[:] = evaluation.targets
        if self._elapsed >= WINDOW:
            self._judge(min(TOLERANCES * self.tolerance, SHARE * asked))

    def _judge(self, slowest: float) -> None:
        """Say at the end of a window whether the tasks are stuck."""
        if self._still:
            self.stuck = abs(self._before - self._least) < slowest * self._elapsed
        else:
            self.stuck = self._moving and self._fastest < slowest
        self._before = self._least
        self._begin()

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
