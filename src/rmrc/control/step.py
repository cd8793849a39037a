"""`Step` and `Status`: what a controller returns, and what happened on the way."""

from collections.abc import Iterator, Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.qp.program import Solution

Array = NDArray[np.float64]


class Status(IntEnum):
    """What happened in a step, in the order of severity."""

    OK = 0
    LIMITED = 1
    SCALED = 2
    DAMPED = 3
    RECOVERING = 4
    RELAXED = 5
    STUCK = 6
    MAX_ITER = 7
    DEADLINE = 8
    STALE = 9
    INVALID_INPUT = 10

    @property
    def advice(self) -> str:
        """One sentence on what the status means and what to do about it."""
        return ADVICE[self]


ADVICE = {
    Status.OK: "Solved; no limit is active.",
    Status.LIMITED: "Solved; at least one joint is at a limit, so the task may lag behind.",
    Status.SCALED: "A direction-preserving task runs slower than asked, to stay inside the limits.",
    Status.DAMPED: "The robot is near a singularity and the damping is above its floor.",
    Status.RECOVERING: "A joint is outside its range and is moving back inside.",
    Status.RELAXED: "A collision or equality row could not hold and was given slack.",
    Status.STUCK: "The error is above tolerance and no progress is possible inside the limits.",
    Status.MAX_ITER: "The solver gave no certified optimum; v is a feasible point or braking.",
    Status.DEADLINE: "The solver ran out of its time budget; v is a feasible point.",
    Status.STALE: "The target or the measurement is older than its timeout; the robot is braking.",
    Status.INVALID_INPUT: "An input was not valid: a bad target is ignored, a bad q or dt brakes.",
}


class Errors(Mapping[str, Array]):
    """The true errors of the tasks by name, computed when they are asked for.

    A pose has the distance in m and the angle in rad, a point the distance in m, a direction
    the angle in rad, joints the norm in rad.
    """

    __slots__ = ("_error", "_evaluation")

    def __init__(self, evaluation: Evaluation, error: Array):
        self._evaluation, self._error = evaluation, error

    def __getitem__(self, name: str) -> Array:
        term = self._evaluation.problem.named(name)
        if not term.units:
            return np.zeros(0)
        return term.measure(self._evaluation.error_of(self._error, term))

    def __iter__(self) -> Iterator[str]:
        return (term.name for term in self._evaluation.terms if term.units)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Step:
    """One control step: the command, and what there is to know about it."""

    __slots__ = ("error", "flag_bits", "q", "solution", "v")

    def __init__(self, v: Array, q: Array, flag_bits: int, error: Errors, solution: Solution):
        self.v = v
        """Joint velocity to command (nv,), rad/s or m/s; always finite and inside the box."""
        self.q = q
        """Configuration (nq,) that v leads to in one step."""
        self.flag_bits = flag_bits
        """The statuses that hold, bit k for the status of value k."""
        self.error = error
        """True errors of the tasks before the step, by name."""
        self.solution = solution
        """What the backend returned, with its certificate."""

    @property
    def status(self) -> Status:
        """The most severe of the statuses that hold."""
        return Status(max(self.flag_bits.bit_length() - 1, 0))

    @property
    def flags(self) -> frozenset[Status]:
        """All the statuses that hold."""
        return frozenset(s for s in Status if self.flag_bits >> s & 1) or frozenset({Status.OK})

    def __repr__(self) -> str:
        return f"Step({self.status.name}, v={np.array2string(self.v, precision=4)})"
