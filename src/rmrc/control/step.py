"""`Step` and `Status`: what a controller returns, and what happened on the way."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from rmrc.errors import printable
from rmrc.problem.evaluation import Kept
from rmrc.problem.problem import Problem
from rmrc.qp.program import Solution
from rmrc.qp.rows import KeptRows, PackedRows

if TYPE_CHECKING:
    from rmrc.control.explain import Explanation
    from rmrc.engine.closed_form import MethodEngine
    from rmrc.engine.python import PythonEngine

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


class Errors(Mapping[str, Array]):
    """The true errors of the tasks by name, computed when they are asked for.

    A pose has the distance in m and the angle in rad, a point the distance in m, a direction
    the angle in rad, joints the norm over those that shift in m and over those that turn in rad.
    Those of rates are of the command itself.
    """

    __slots__ = ("_evaluation", "_moment", "_v")

    def __init__(self, moment: "Moment", v: Array):
        self._evaluation, self._moment, self._v = moment.engine.evaluation, moment, v

    def __getitem__(self, name: str) -> Array:
        term = self._evaluation.problem.named(name)
        if not term.units:
            return np.zeros(0)
        error = self._evaluation.error_of(self._moment.error, term)
        return term.measure(term.after(error, self._moment.v_previous, self._v))

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
        "invalid",
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
        invalid: tuple[str, ...] = (),
    ):
        self.engine, self.invalid = engine, invalid
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

    def packed(self) -> "Packed":
        """Return what there is to it without the engine."""
        rows = self._rows and self._rows.packed(self.engine.rows)
        return Packed(
            *(self.engine.problem, self.q, self.v_previous, self.a_previous, self.dt),
            *(self._kept, rows, self.share, self.invalid),
        )

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


class Packed(NamedTuple):
    """A moment without its engine."""

    problem: Problem
    q: Array
    v_previous: Array
    a_previous: Array
    dt: float
    kept: Kept
    rows: PackedRows | None
    share: float
    invalid: tuple[str, ...]

    def unpacked(self) -> Moment:
        """Return the moment with an engine for the problem, the same one for all of its steps."""
        from rmrc.control.engines import build_engine  # which needs this module

        engine = _ENGINES.get(self.problem)
        if engine is None:
            engine = _ENGINES[self.problem] = build_engine(self.problem, "python")[0]
        rows = self.rows and self.rows.unpacked(engine.rows)
        return Moment(
            *(engine, self.q, self.v_previous, self.a_previous, self.dt),
            *(self.kept, rows, self.share, self.invalid),
        )


_ENGINES: WeakKeyDictionary[Problem, Any] = WeakKeyDictionary()


class Unpickled:
    """A step that was pickled: an engine is made where something asks for its moment."""

    def __init__(self, v: Array, q: Array, solution: Solution, packed: Packed):
        self.v, self.q, self.solution, self._packed = v, q, solution, packed

    @cached_property
    def moment(self) -> Moment:
        """See `Step.moment`."""
        return self._packed.unpacked()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "moment"}


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

    def __deepcopy__(self, memo: dict[int, Any]) -> "Step":
        """Return a step with arrays of its own; what it was computed from is the same."""
        made = Made(self.v.copy(), self.q.copy(), deepcopy(self.solution, memo), self.moment)
        return Step(made, self.flag_bits)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the same step anywhere: its numbers, and the problem."""
        source = Unpickled(self.v, self.q, self.solution, self.moment.packed())
        return Step, (source, self.flag_bits)

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
        """Why an input was not valid, the limits that are passed, and why the robot is stuck.

        As "q[2] is nan; the robot brakes", "passes the velocity limit of joint2 by 0.3 rad/s", of
        methods that keep none, and "out of reach by 0.23 m". The last two are found when they are
        asked for, those of what is stuck with an evaluation for each dof.
        """
        invalid = self.moment.invalid if self.flag_bits >> Status.INVALID_INPUT & 1 else ()
        limited = self.flag_bits >> Status.LIMITED & 1 and self.moment.engine.problem.config.method
        stuck = self.flag_bits >> Status.STUCK & 1
        if not (stuck or limited not in (0, "qp")):
            return tuple(map(printable, invalid))
        account = self.explain()
        found = account.reasons if stuck else ()
        several = len({reason.task for reason in found}) > 1
        said = (
            *invalid,
            *(f"passes the {p.limit} limit of {p}" for p in account.broken),
            *(f"{r.task}: {r.what}" if several else r.what for r in found),
        )
        return tuple(map(printable, said))

    @property
    def error(self) -> Errors:
        """True errors of the tasks before the step, by name."""
        return Errors(self.moment, self.v)

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
