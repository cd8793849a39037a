"""A controller's common steps in C++: what is handed to the extension, and what is made of it."""

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.control.inputs import Configurations
from rmrc.control.progress import Progress
from rmrc.control.step import Moment, Step
from rmrc.problem.evaluation import Kept
from rmrc.qp.program import KKT, Solution, SolveStatus
from rmrc.qp.rows import KeptRows

if TYPE_CHECKING:
    from rmrc.native.engine import NativeEngine

Array = NDArray[np.float64]

_NONE = np.zeros(0)


class Layout:
    """Where the numbers of a record stand that the extension has noted one after another."""

    def __init__(self, engine: "NativeEngine"):
        model, data, evaluation = engine.problem.model, engine.evaluation.data, engine.evaluation
        nq, nv, n = model.nq, model.nv, engine.problem.dofs.size
        self.kept = {
            "error": evaluation.error,
            "targets": evaluation.targets,
            "twists": evaluation.twists,
        }
        """The arrays that each step keeps a copy of."""
        if model.nmocap:
            self.kept |= {
                "mocap_pos": data.mocap_pos,
                "mocap_quat": data.mocap_quat,
                "obstacle_twist": evaluation.obstacle_twist,
            }
        first = {"kkt": 3, "dt": 1, "share": 1, "v": nv, "q": nq, "from": nq}
        first |= {"v_previous": nv, "z": n}
        shapes = {name: (size,) for name, size in first.items()}
        shapes |= {name: array.shape for name, array in self.kept.items()}
        shapes["moving"] = (len(evaluation.moving),)
        self._parts: dict[str, tuple[slice, tuple[int, ...]]] = {}
        end = 0
        for name, shape in shapes.items():
            begin, end = end, end + math.prod(shape)
            self._parts[name] = (slice(begin, end), shape)
        self._rows, self._end = engine.rows, end

    def part(self, numbers: Array, name: str) -> Array:
        """Return an array by its name."""
        place, shape = self._parts[name]
        return numbers[place].reshape(shape)

    def rows(self, numbers: Array) -> tuple[KeptRows | None, Array, Array]:
        """Return the rows of a step, if it had any, and the multipliers of rows and equalities."""
        rows, barriers = self._rows, self._rows.barriers
        counts, numbers = np.split(numbers[self._end :], [len(barriers)])
        count = rows.speed_count + int(counts.sum())
        of_rows, of_equalities = np.split(numbers, [4 * count])
        if not count:
            return None, _NONE, of_equalities
        ids, lower, upper, multiplier = of_rows.reshape(4, -1)
        blocks, first = [], rows.speed_count
        for barrier, count in zip(barriers, counts.astype(int).tolist(), strict=True):
            part = slice(first, first + count)
            blocks.append((barrier, ids[part].astype(np.intp), part))
            first += count
        return KeptRows(rows.speeds, blocks, lower, upper), multiplier, of_equalities

    def surroundings(self, numbers: Array) -> Kept:
        """Return the error of a step, and what it depended on beside q and v_prev."""
        moving = self.part(numbers, "moving").astype(np.uint8).tobytes()
        twists = (moving, self.part(numbers, "twists")) if 1 in moving else None
        obstacles = None
        if "mocap_pos" in self.kept:
            obstacles = (
                self.part(numbers, "mocap_pos"),
                self.part(numbers, "mocap_quat"),
                self.part(numbers, "obstacle_twist"),
            )
        return Kept(self.part(numbers, "error"), self.part(numbers, "targets"), twists, obstacles)


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


def build_stepper(
    engine: "NativeEngine", native: _native.Engine, q: Array, v: Array
) -> _native.Stepper:
    """Return what takes the common steps of a controller at q (nq,) that moves with v (nv,)."""
    problem, evaluation = engine.problem, engine.evaluation
    terms, moving = evaluation.terms, np.frombuffer(evaluation.moving, dtype=np.uint8)
    places = {term.name: k for k, term in enumerate(terms)}
    progress = Progress(problem, evaluation, engine.assembly)
    stepper = _native.Stepper(
        engine=native,
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
