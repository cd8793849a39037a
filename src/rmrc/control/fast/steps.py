"""A controller's common steps in C++: what is handed to the extension, and what is made of it."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.control.context import Moment
from rmrc.control.inputs import Configurations
from rmrc.control.progress import Progress
from rmrc.control.step import Step
from rmrc.native.engine import NativeEngine
from rmrc.qp.program import KKT, Solution, SolveStatus

Array = NDArray[np.float64]


class Taken:
    """What a step of the extension's was, made of its record when it is asked for."""

    def __init__(self, record: _native.Record):
        self._record, self._engine, self._numbers = record, record.engine, record.numbers

    @property
    def v(self) -> Array:
        """See `Step.v`."""
        return self._engine.layout.part(self._numbers, "v")

    @property
    def q(self) -> Array:
        """See `Step.q`."""
        return self._engine.layout.part(self._numbers, "q")

    @cached_property
    def solution(self) -> Solution:
        """What the solver returned, with its certificate."""
        layout, numbers, record = self._engine.layout, self._numbers, self._record
        v, kkt = self.v[self._engine.problem.dofs], layout.part(numbers, "kkt")
        z, (_, y, w) = layout.part(numbers, "z"), layout.rows(numbers)
        status = SolveStatus(record.ending)
        return Solution(v, z, y, w, record.iterations, status, KKT(*kkt.tolist()))

    @cached_property
    def moment(self) -> Moment:
        """What the step was computed from."""
        layout, numbers = self._engine.layout, self._numbers
        q, v_previous = layout.part(numbers, "from"), layout.part(numbers, "v_previous")
        dt, at_rest = layout.part(numbers, "dt").item(), np.zeros_like(v_previous)
        kept, rows = layout.surroundings(numbers), layout.rows(numbers)[0]
        share = layout.part(numbers, "share").item()
        return Moment(self._engine, q, v_previous, at_rest, dt, kept, rows, share)


_native.set_step_type(Step, Taken)


def build_stepper(engine: NativeEngine, q: Array, v: Array) -> _native.Stepper:
    """Return what takes a controller's common steps in C++.

    Args:
        engine: One that takes them all alone.
        q: The controller's configuration (nq,), and where a step leads to.
        v: Its last command (nv,), and the next.
    """
    problem, evaluation = engine.problem, engine.evaluation
    terms, moving = evaluation.terms, np.frombuffer(evaluation.moving, dtype=np.uint8)
    places = {term.name: k for k, term in enumerate(terms)}
    progress = Progress(problem, evaluation, engine.assembly)
    stepper = _native.Stepper(
        engine=engine.native,
        owner=engine,
        q=q,
        v=v,
        v_previous=evaluation.v_previous,
        dt=problem.dt,
        quaternions=Configurations(problem.model).quaternions,
        frozen=(problem.box.velocity == 0.0).tolist(),
        budget=problem.deadline,
        kept=list(engine.layout.kept.values()),
        moving=moving,
        watched=[
            (places[term.name], weight.tolist(), *limits)
            for term, weight, limits in progress.watched()
        ],
        tolerance=progress.tolerance,
    )
    for term in terms:
        if term.target_kind in ("pose", "point"):
            index = evaluation.index[term.name]
            stepper.add_target(
                term.name,
                term.target_kind == "pose",
                evaluation.target[term.name],
                evaluation.twist[term.name],
                evaluation.feedforward[evaluation.rows_of([term])],
                moving[index : index + 1],
            )
    return stepper
