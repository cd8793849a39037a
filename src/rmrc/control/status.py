"""`Status`: what happened in a step, in the order of severity, and what to do about it."""

from enum import IntEnum

ACTIVE_MULTIPLIER = 1e-7
"""A limit is active where its multiplier is above this, in the program's unit."""


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

    def __str__(self) -> str:
        return self.name

    @property
    def advice(self) -> str:
        """One sentence on what the status means and what to do about it."""
        return ADVICE[self]


ADVICE = {
    Status.OK: "Solved; no limit is active.",
    Status.LIMITED: "Solved; a limit is active, so the task may lag behind, or passed by a method "
    "that keeps none.",
    Status.SCALED: "A direction-preserving task runs slower than asked, to stay inside the limits.",
    Status.DAMPED: "The damping is above its floor: near a singularity, or far from the target.",
    Status.RECOVERING: "A joint or a distance is outside its limit and is moving back inside.",
    Status.RELAXED: "A collision or equality row could not hold and was given slack.",
    Status.STUCK: "The robot rests, and an error is above tolerance; `explain` says why.",
    Status.MAX_ITER: "The solver gave no certified optimum; v is a feasible point or braking.",
    Status.DEADLINE: "The solver ran out of its time budget; v is a feasible point.",
    Status.STALE: "The target or the measurement is older than its timeout; the robot is braking.",
    Status.INVALID_INPUT: "An input was not valid: a bad target is ignored, all else brakes.",
}
