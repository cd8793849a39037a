"""A pose solved to convergence: the problem's own step, repeated as Gauss–Newton's."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rmrc.control.controller import Controller
from rmrc.problem.problem import Problem

Array = NDArray[np.float64]

MOST_ITERATIONS = 200
"""Steps after which a pose counts as not reached."""
STILL = 1e-9
"""A step shorter than this, rad or m, is no progress."""
PROGRESS = 0.9
"""An error that is more than this share of the one before has stopped falling."""
SHARE = 1e-3
"""Share of the run's tolerance that a pose is solved to."""


@dataclass(frozen=True, eq=False)
class Reached:
    """Where the iteration ended."""

    q: Array
    """Configuration (nq,)."""
    iterations: int
    converged: bool
    """Whether every decisive error of the highest level is within the run's tolerance."""


class Reacher:
    """Solves poses of a problem to convergence, from one start after another.

    Each iteration is a step of one second at deadbeat gain, v = Δq, inside the position limits but
    free of the limits on rates, by the problem's own method.
    """

    def __init__(self, problem: Problem):
        free = np.full(problem.dofs.size, np.inf)
        still = problem.box.velocity == 0.0
        box = replace(
            problem.box,
            gain=1.0,
            velocity=np.where(still, 0.0, free),  # frozen joints stay frozen
            acceleration=free,
            jerk=free,
        )
        terms = tuple(replace(t, gain=np.inf) if t.gain else t for t in problem.terms)
        self._problem = replace(
            problem,
            dt=1.0,
            terms=terms,
            box=box,
            speeds=(),
            deadline=math.inf,
            target_timeout=math.inf,
            measurement_timeout=math.inf,
        )
        self.controller = Controller(self._problem)
        """Its targets are what is solved for."""
        tolerance = problem.config.tolerance
        self._tolerance = {"m": tolerance.position, "rad": tolerance.orientation}

    def solve(self, q: Array) -> Reached:
        """Return what the iteration from q (nq,) reaches for the present targets.

        It ends well inside the tolerance, or inside it where the error falls no further, as under
        a lower level's pull; or where nothing moves any more.
        """
        step, last = self.controller.step(q), np.inf
        for iteration in range(1, MOST_ITERATIONS + 1):
            excess = self._excess()
            if excess <= SHARE or PROGRESS * last < excess <= 1.0:
                return Reached(q, iteration, True)
            if float(np.abs(step.v).max()) < STILL:
                return Reached(q, iteration, excess <= 1.0)
            q, last = step.q, excess
            step = self.controller.step(q)
        return Reached(q, MOST_ITERATIONS, self._excess() <= 1.0)

    def _excess(self) -> float:
        """Return the largest decisive error before the last step, in shares of its tolerance."""
        evaluation, largest = self.controller.engine.evaluation, 0.0
        for term in self._problem.terms:
            if term.level == 0 and term.decisive:
                measured = term.measure(evaluation.error_of(evaluation.error, term))
                for value, unit in zip(measured, term.units, strict=True):
                    largest = max(largest, float(value) / self._tolerance[unit])
        return largest
