"""Why a step is what it is: what binds, what each task asked for and got, what would help."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rmrc.control.context import Moment
from rmrc.control.joint_bounds import JointBounds
from rmrc.control.reasons import Reason, reasons
from rmrc.control.status import ACTIVE_MULTIPLIER, Status
from rmrc.engine.closed_form import PASSED
from rmrc.errors import printable
from rmrc.model.configuration import turning_dofs
from rmrc.qp.program import Solution
from rmrc.tasks.base import Term

if TYPE_CHECKING:
    from rmrc.control.step import Step

Array = NDArray[np.float64]

SHOWN = 6
"""Distances below their limits that are named."""


@dataclass(frozen=True)
class Binding:
    """A limit that is active."""

    limit: str
    """Its kind, as the configuration names it, or `loop` and the like for equalities."""
    name: str
    """The joint, the pair of geoms, the frame or the task."""
    side: str
    """lower or upper."""
    bound: float
    """Where it stands, rad/s or m/s."""
    multiplier: float
    """What the cost falls by for each rad/s or m/s that it is relaxed by."""

    def __str__(self) -> str:
        return (
            f"{self.limit} limit of {self.name}: {self.side} bound {self.bound:.4g}, "
            f"multiplier {self.multiplier:.3g}"
        )


@dataclass(frozen=True)
class Progressed:
    """What one task asked for and got, one entry for each of its units."""

    name: str
    units: tuple[str, ...]
    """m or rad."""
    error: tuple[float, ...]
    """True distance or angle from the target before the step."""
    asked: tuple[float, ...]
    """Speed that was asked for, in units a second."""
    got: tuple[float, ...]
    """The part of the speed along what was asked for."""

    def __str__(self) -> str:
        parts = (
            f"{error:.4g} {unit} off, asked for {asked:.4g} {unit}/s, got {got:.4g}"
            for unit, error, asked, got in zip(
                self.units, self.error, self.asked, self.got, strict=True
            )
        )
        return f"{self.name}: {'; '.join(parts)}"


@dataclass(frozen=True)
class Passed:
    """A distance that was below its limit at the beginning of a step."""

    limit: str
    """Its kind, as the configuration names it."""
    name: str
    """The pair of geoms, the frame or the joint."""
    by: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} by {self.by:.4g} {self.unit} ({self.limit})"


@dataclass(frozen=True)
class Broken:
    """A limit of a joint that a command passes."""

    limit: str
    """Its kind, as the configuration names it."""
    name: str
    """The joint."""
    by: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} by {self.by:.3g} {self.unit}"


@dataclass(frozen=True)
class Explanation:
    """An account of one step."""

    status: Status
    flags: tuple[Status, ...]
    """All statuses that hold, the most severe first."""
    bindings: tuple[Binding, ...]
    """The active limits, those that cost most first."""
    tasks: tuple[Progressed, ...]
    share: float
    """What the check of distances at the next configuration left of the command, 1 for all."""
    passed: tuple[Passed, ...] = ()
    """The distances that were below their limits, the furthest first. No step takes them further,
    so that many at once can hold a robot where it is."""
    reasons: tuple[Reason, ...] = ()
    """Why the tasks are not there, of a step that is stuck."""
    curvature: tuple[str, float, float] | None = None
    """The joint that the tasks' curvature damps most, by how much, and λ²; None without any."""
    invalid: tuple[str, ...] = ()
    """What was wrong with the inputs."""
    broken: tuple[Broken, ...] = ()
    """The limits of joints that the command of a method passes that keeps none, the most first."""

    @property
    def relief(self) -> Binding | None:
        """The limit that would help most, if it were relaxed by a rad/s or m/s."""
        return self.bindings[0] if self.bindings else None

    def __str__(self) -> str:
        lines = [f"{flag.name}: {flag.advice}" for flag in self.flags]
        if self.invalid:
            lines += ["what was not valid:", *(f"  {what}" for what in self.invalid)]
        if self.reasons:
            lines += ["why it is not there:", *(f"  {reason}" for reason in self.reasons)]
        if self.bindings:
            lines += ["what binds:", *(f"  {binding}" for binding in self.bindings)]
        elif not self.broken:
            lines.append("no limit binds")
        if self.broken:
            lines += ["what is passed, for the method keeps no limit of the kind:"]
            lines += [f"  {broken.limit} limit of {broken}" for broken in self.broken]
        if self.share < 1.0:
            lines.append(
                f"the command was shortened to {self.share:.0%}, to keep distances after the step"
            )
        if self.passed:
            more = len(self.passed) - SHOWN
            lines += [
                "beyond its limit, and taken no further:",
                *(f"  {passed}" for passed in self.passed[:SHOWN]),
                *([f"  and {more} more"] if more > 0 else []),
            ]
        if self.tasks:
            lines += ["what the tasks asked for and got:", *(f"  {task}" for task in self.tasks)]
        if self.curvature is not None:
            joint, added, square = self.curvature
            lines.append(
                f"damping: λ² = {square:.3g}, and for the curvature of the tasks up to "
                f"{added:.3g} more, at {joint}"
            )
        if self.relief is not None and not self.reasons:
            lines.append(
                f"what would help most: relaxing the {self.relief.limit} limit of "
                f"{self.relief.name}"
            )
        return "\n".join(map(printable, lines))


def explain(step: "Step", stuck: bool | None = None) -> Explanation:
    """Return the account of a step, from its multipliers and its state evaluated again.

    Args:
        step: The step.
        stuck: Whether the robot was stuck in it; by default as the step says.
    """
    moment, solution = step.moment, step.solution
    problem = moment.engine.problem
    flags = tuple(sorted(step.flags, reverse=True))
    with moment.restored():
        bindings = [
            *_joints(moment, solution),
            *_rows(moment, solution),
        ]
        tasks = [_progressed(term, moment, step) for term in problem.terms if term.units]
        passed, broken = _passed(moment), _broken(moment, solution)
        is_stuck = Status.STUCK in flags if stuck is None else stuck
        found = reasons(moment, solution) if is_stuck else ()
        curvature = _curvature(moment)
    bindings.sort(key=lambda binding: -abs(binding.multiplier))
    return Explanation(
        step.status,
        flags,
        tuple(bindings),
        tuple(tasks),
        moment.share,
        tuple(passed),
        found,
        curvature,
        moment.invalid,
        tuple(broken),
    )


def _curvature(moment: Moment) -> tuple[str, float, float] | None:
    """Return the joint that X damps most, its X, and λ², in the unit of the weights."""
    assembly, evaluation = moment.engine.assembly, moment.engine.evaluation
    # The native engine keeps its own X to itself.
    assembly.curvature.update(assembly.rate - evaluation.feedforward, moment.dt)
    added = sum(assembly.curvature.levels.values(), np.zeros(moment.engine.problem.dofs.size))
    k = int(added.argmax())
    if not added[k] > 0.0:
        return None
    return JointBounds(moment).name(k), float(added[k]) / assembly.unit, assembly.damping**2


def _passed(moment: Moment) -> list[Passed]:
    """Return the distances below their limits, the furthest first."""
    found = [
        Passed(block.barrier.kind, block.barrier.name(entry), -distance, block.barrier.unit)
        for block in moment.engine.rows.blocks
        for entry, distance in zip(
            block.near.ids.tolist(), block.near.distance.tolist(), strict=True
        )
        if distance < -moment.engine.problem.resolution
    ]
    return sorted(found, key=lambda passed: -passed.by)


def _broken(moment: Moment, solution: Solution) -> list[Broken]:
    """Return the limits of joints that a command passes, the most first."""
    if moment.engine.problem.config.method == "qp":
        return []
    bounds, qp, found = JointBounds(moment), moment.engine.assembly.qp, []
    turning, dofs = turning_dofs(moment.engine.problem.model), moment.engine.problem.dofs
    for side, beyond in (("lower", qp.lb - solution.v), ("upper", solution.v - qp.ub)):
        for k in np.flatnonzero(beyond > PASSED).tolist():
            unit = "rad/s" if turning[dofs[k]] else "m/s"
            found.append(Broken(bounds.kind(k, side), bounds.name(k), float(beyond[k]), unit))
    return sorted(found, key=lambda broken: -broken.by)


def _joints(moment: Moment, solution: Solution) -> list[Binding]:
    """Return the active bounds of the joints."""
    bounds, unit, found = JointBounds(moment), moment.engine.assembly.unit, []
    for k in np.flatnonzero(np.abs(solution.bound_multiplier) > ACTIVE_MULTIPLIER).tolist():
        multiplier = float(solution.bound_multiplier[k])
        side = "upper" if multiplier > 0.0 else "lower"
        named = bounds.kind(k, side), bounds.name(k), side, bounds.bound(k, side)
        found.append(Binding(*named, abs(multiplier) / unit))
    return found


def _rows(moment: Moment, solution: Solution) -> list[Binding]:
    """Return the active limits among the rows; several planes may stand for one speed."""
    unit = moment.engine.assembly.unit
    found: dict[tuple[str, str, str, float], float] = {}
    for k in np.flatnonzero(np.abs(solution.row_multiplier) > ACTIVE_MULTIPLIER).tolist():
        multiplier = float(solution.row_multiplier[k])
        kind, name, lower, upper = moment.named_row(k)
        side, bound = ("upper", upper) if multiplier > 0.0 else ("lower", lower)
        limit = (kind, name, side, bound)
        found[limit] = found.get(limit, 0.0) + abs(multiplier) / unit
    return [Binding(*limit, multiplier) for limit, multiplier in found.items()]


def _progressed(term: Term, moment: Moment, step: "Step") -> Progressed:
    """Return what a task asked for and got."""
    engine = moment.engine
    evaluation, dofs = engine.evaluation, engine.problem.dofs
    part = evaluation.rows_of([term])
    asked_for = engine.assembly.rate[part]
    if term.joint:
        got = step.v
    else:
        got = evaluation.jacobian[part][:, dofs] @ step.v[dofs]
    asked, gained = [], []
    for rows in term.unit_rows:
        wanted, reached = asked_for[rows], got[rows]
        length = math.sqrt(wanted.dot(wanted))
        asked.append(length)
        gained.append(float(wanted @ reached) / length if length > 0.0 else 0.0)
    error = tuple(float(value) for value in step.error[term.name])
    return Progressed(term.name, term.units, error, tuple(asked), tuple(gained))
