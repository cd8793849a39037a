"""A controller's common steps in C++: what is handed to the extension, and what is made of it."""

import math
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

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
    from rmrc.control.native import NativeEngine

Array = NDArray[np.float64]

_NONE = np.zeros(0)


class Stepper(NamedTuple):
    """What takes common steps, and its number of each target that it may set."""

    native: _native.Stepper
    targets: dict[str, int]


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

    def part(self, record: _native.Record, name: str) -> Array:
        """Return a copy of an array by its name: a view would keep a record alive that keeps it."""
        place, shape = self._parts[name]
        return np.frombuffer(memoryview(record))[place].reshape(shape).copy()

    def rows(self, record: _native.Record) -> tuple[KeptRows | None, Array, Array]:
        """Return the rows of a step, if it had any, and the multipliers of rows and equalities."""
        rows, barriers = self._rows, self._rows.barriers
        numbers = np.frombuffer(memoryview(record))[self._end :].copy()
        counts = numbers[: len(barriers)].astype(int).tolist()
        count = rows.speed_count + sum(counts)
        end = len(barriers) + 4 * count
        if not count:
            return None, _NONE, numbers[end:]
        ids, lower, upper, multiplier = numbers[len(barriers) : end].reshape(4, -1)
        blocks, first = [], rows.speed_count
        for barrier, count in zip(barriers, counts, strict=True):
            part = slice(first, first + count)
            blocks.append((barrier, ids[part].astype(np.intp), part))
            first += count
        return KeptRows(rows.speeds, blocks, lower, upper), multiplier, numbers[end:]

    def surroundings(self, record: _native.Record) -> Kept:
        """Return the error of a step, and what it depended on beside q and v_prev."""
        moving = self.part(record, "moving").astype(np.uint8).tobytes()
        twists = (moving, self.part(record, "twists")) if 1 in moving else None
        obstacles = None
        if "mocap_pos" in self.kept:
            obstacles = (
                self.part(record, "mocap_pos"),
                self.part(record, "mocap_quat"),
                self.part(record, "obstacle_twist"),
            )
        return Kept(self.part(record, "error"), self.part(record, "targets"), twists, obstacles)


class Record(_native.Record):
    """A step of the extension's, of which the rest is made when it is asked for."""

    @cached_property
    def solution(self) -> Solution:
        """What the solver returned, with its certificate."""
        part = self.engine.layout.part
        v, z, kkt = self.v[self.engine.problem.dofs], part(self, "z"), part(self, "kkt")
        status = SolveStatus(self.ending)
        _, y, w = self.engine.layout.rows(self)
        return Solution(v, z, y, w, self.iterations, status, KKT(*kkt.tolist()))

    @cached_property
    def moment(self) -> Moment:
        """What the step was computed from."""
        layout = self.engine.layout
        q, v_previous = layout.part(self, "from"), layout.part(self, "v_previous")
        dt, at_rest = layout.part(self, "dt").item(), np.zeros_like(v_previous)
        kept, rows = layout.surroundings(self), layout.rows(self)[0]
        share = layout.part(self, "share").item()
        return Moment(self.engine, q, v_previous, at_rest, dt, kept, rows, share)


def build_stepper(engine: "NativeEngine", native: _native.Engine, q: Array, v: Array) -> Stepper:
    """Return what takes the common steps of a controller at q (nq,) that moves with v (nv,)."""
    problem, evaluation = engine.problem, engine.evaluation
    terms, moving = evaluation.terms, np.frombuffer(evaluation.moving, dtype=np.uint8)
    places = {term.name: k for k, term in enumerate(terms)}
    progress = Progress(problem, evaluation, engine.assembly)
    stepper = _native.Stepper(
        engine=native,
        step=Step,
        record=Record,
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
        targets=evaluation.targets,
        tolerance=progress.tolerance,
    )
    targets = {}
    for term in terms:
        if term.target_kind in ("pose", "point"):
            index = evaluation.index[term.name]
            targets[term.name] = stepper.add_target(
                term.target_kind == "pose",
                evaluation.target[term.name],
                evaluation.twist[term.name],
                evaluation.feedforward[evaluation.rows_of([term])],
                moving[index : index + 1],
            )
    return Stepper(stepper, targets)
