"""What a step was computed from, kept so that it can be explained later."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from rmrc.control.engines import build_engine
from rmrc.problem.evaluation import Kept
from rmrc.problem.problem import Problem
from rmrc.qp.rows import KeptRows, PackedRows

if TYPE_CHECKING:
    from rmrc.engine.closed_form import MethodEngine
    from rmrc.engine.python import PythonEngine

Array = NDArray[np.float64]


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
        engine = _ENGINES.get(self.problem)
        if engine is None:
            engine = _ENGINES[self.problem] = build_engine(self.problem, "python")[0]
        rows = self.rows and self.rows.unpacked(engine.rows)
        return Moment(
            *(engine, self.q, self.v_previous, self.a_previous, self.dt),
            *(self.kept, rows, self.share, self.invalid),
        )


_ENGINES: WeakKeyDictionary[Problem, Any] = WeakKeyDictionary()
