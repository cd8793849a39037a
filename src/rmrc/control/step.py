"""`Step` and `Status`: what a controller returns, and what happened on the way."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rmrc.control.context import Moment, Packed
from rmrc.control.explain import Explanation, explain
from rmrc.control.status import Status
from rmrc.errors import printable
from rmrc.qp.program import Solution

Array = NDArray[np.float64]


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
