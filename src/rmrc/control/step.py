"""`Step` and `Status`: what a controller returns, and what happened on the way."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation, Kept
from rmrc.qp.program import Solution
from rmrc.qp.rows import KeptRows

if TYPE_CHECKING:
    from rmrc.control.engine import PythonEngine
    from rmrc.control.explain import Explanation
    from rmrc.control.methods import MethodEngine

Array = NDArray[np.float64]

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

    @property
    def advice(self) -> str:
        """One sentence on what the status means and what to do about it."""
        return ADVICE[self]


ADVICE = {
    Status.OK: "Solved; no limit is active.",
    Status.LIMITED: "Solved; at least one limit is active, so the task may lag behind.",
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


class Moment:
    """What a step was computed from, kept so that it can be explained later."""

    __slots__ = (
        "_kept",
        "_rows",
        "a_previous",
        "dt",
        "engine",
        "error",
        "q",
        "share",
        "v_previous",
    )

    def __init__(
        self,
        engine: "PythonEngine | MethodEngine",
        q: Array,
        v_previous: Array,
        a_previous: Array,
        dt: float,
        kept: Kept | None = None,
        rows: KeptRows | None = None,
        share: float = 1.0,
    ):
        self.engine = engine
        self.q, self.v_previous, self.a_previous, self.dt = q, v_previous, a_previous, dt
        if kept is None:
            self._kept, self.share = engine.evaluation.keep(), engine.share
            self._rows = engine.rows.kept() if engine.rows.count else None
        else:
            self._kept, self.share, self._rows = kept, share, rows
        self.error = self._kept.error

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Have the engine at this moment again, and afterwards its targets as they were."""
        engine = self.engine
        now = Moment(engine, self.q, self.v_previous, self.a_previous, self.dt)
        memory = [array for barrier in engine.rows.barriers for array in barrier.memory]
        remembered = [array.copy() for array in memory]
        engine.evaluation.restore(self._kept)
        engine.evaluation.a_previous[:] = self.a_previous
        engine.prepare(self.q, self.v_previous, self.dt)
        try:
            yield
        finally:
            engine.evaluation.restore(now._kept)
            for array, values in zip(memory, remembered, strict=True):
                array[:] = values

    def named_row(self, row: int) -> tuple[str, str, float, float]:
        """Return the kind of limit that a row belongs to, what it is of, its lo and its hi."""
        assert self._rows is not None
        return self._rows.described(row)


class Source(Protocol):
    """What a step was, made at once or when it is asked for."""

    @property
    def v(self) -> Array:
        """See `Step.v`."""
        ...

    @property
    def q(self) -> Array:
        """See `Step.q`."""
        ...

    @property
    def solution(self) -> Solution:
        """See `Step.solution`."""
        ...

    @property
    def moment(self) -> Moment:
        """See `Step.moment`."""
        ...


class Made(NamedTuple):
    """A step that was made at once."""

    v: Array
    q: Array
    solution: Solution
    moment: Moment


class Step:
    """One control step: the command, and what there is to know about it."""

    __slots__ = ("_source", "flag_bits")

    def __init__(self, source: Source, flag_bits: int):
        self._source = source
        self.flag_bits = flag_bits
        """The statuses that hold, bit k for the status of value k."""

    def __copy__(self) -> "Step":
        """Return the step itself, which nobody changes."""
        return self

    @property
    def v(self) -> Array:
        """Joint velocity to command (nv,), rad/s or m/s; always finite and inside the box."""
        return self._source.v

    @property
    def q(self) -> Array:
        """Configuration (nq,) that v leads to in one step."""
        return self._source.q

    @property
    def solution(self) -> Solution:
        """What the solver returned, with its certificate."""
        return self._source.solution

    @property
    def moment(self) -> Moment:
        """What it was computed from."""
        return self._source.moment

    def explain(self) -> "Explanation":
        """Return what binds, what each task asked for and got, and which limit would help most."""
        from rmrc.control.explain import explain  # which needs this module

        return explain(self)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the robot is stuck, as "out of reach by 0.23 m"; empty where it is not.

        They are found when they are asked for, with an evaluation for each dof.
        """
        if not self.flag_bits >> Status.STUCK & 1:
            return ()
        found = self.explain().reasons
        several = len({reason.task for reason in found}) > 1
        return tuple(f"{r.task}: {r.what}" if several else r.what for r in found)

    @property
    def error(self) -> Errors:
        """True errors of the tasks before the step, by name."""
        return Errors(self.moment.engine.evaluation, self.moment.error)

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
