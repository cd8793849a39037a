"""What every task is made of: its model in the configuration and its term in the problem."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from rmrc.model.objects import Objects
from rmrc.text.base import Model, Name, Positive, Weight

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

Array = NDArray[np.float64]
Gain = Positive | Literal["deadbeat"]
Preserve = Literal["direction"]
TargetKind = Literal["pose", "point", "direction", "configuration", "rates", "none"]


class FieldError(ValueError):
    """A value that does not fit the model or the task, and the key that holds it."""

    def __init__(self, key: str, message: str):
        super().__init__(message)
        self.key = key


class TaskModel(Model):
    """What all tasks share in a configuration."""

    target_kind: ClassVar[TargetKind] = "none"

    name: Name
    """Name of the task; targets, results and messages refer to it."""
    level: Annotated[int, Field(strict=True, ge=0, le=20)] = 0
    """Priority level; 0 is the highest."""

    @abstractmethod
    def compile(self, model: mujoco.MjModel, start: Array) -> "Term":
        """Resolve every name and return the task's term.

        Args:
            model: The MuJoCo model.
            start: Start configuration (nq,).

        Raises:
            FieldError: If a value does not fit the model.
        """

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies with the task's own frame or a joint that it names: robots' bodies.

        Raises:
            ModelError: If the model has no such name.
            FieldError: If a value does not fit the model.
        """
        return []

    def common(self) -> dict[str, Any]:
        """Return what the task's term takes over: name, type, level, gain, and whether it is hard.

        A task without an error of its own to close has no gain.
        """
        return {"gain": 0.0, **self.model_dump(include={"name", "type", "level", "hard"})}


class WeightedTask(TaskModel):
    """A task whose weight may be a number, a diagonal or a matrix."""

    B: Weight = 1.0
    """Weight of the squared error, Whitney's B: a number, a diagonal or a symmetric matrix."""


class GainedTask(TaskModel):
    """A task with an error that decays at a gain."""

    gain: Gain = 10.0
    """Gain K in 1/s of the error's decay, never above 1/dt; `deadbeat` is 1/dt."""

    def common(self) -> dict[str, Any]:
        """Return what the task's term takes over, with its gain K in 1/s."""
        return super().common() | {"gain": gain_value(self.gain)}


class HardTask(TaskModel):
    """A task that may be a constraint in place of a cost."""

    hard: Annotated[bool, Field(strict=True)] = False
    """Whether J v = ẋ is an equality, which comes before all levels; B then only tells which
    directions are meant: those with a weight."""

    @field_validator("hard")
    @classmethod
    def _no_level(cls, hard: bool, others: ValidationInfo) -> bool:
        if hard and others.data.get("level"):
            raise ValueError(
                "a hard task comes before all levels: leave `level` out, or set `hard: false`"
            )
        return hard


class ConstraintTask(HardTask, GainedTask):
    """A property of the mechanism, which is hard if nothing else is said."""

    hard: Annotated[bool, Field(strict=True, validate_default=True)] = True
    """Whether it is an equality, which comes before all levels, or a cost with the weight B."""
    gain: Gain = 100.0
    """Gain K in 1/s with which what is open closes, never above 1/dt; `deadbeat` is 1/dt."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Term(ABC):
    """One task as the engine sees it: names resolved, weights as arrays.

    A term gives rows J (rows, nv) and an error e (rows,) with de/dt = −J v, so that J v = K e
    makes the error decay as exp(−K t).
    """

    name: str
    type: str
    level: int
    gain: float
    """K in 1/s; infinity is deadbeat, 0 where only the feed-forward drives."""
    weight: Array
    """B as a diagonal (rows,) or a matrix (rows, rows)."""
    target: Array
    """The target at the start, of size 0 where there is none."""
    preserve: bool = False
    """Whether the task moves along its ẋ, as fast as the limits allow, in place of its cost."""
    hard: bool = False
    """Whether J v = ẋ is an equality in the directions that have a weight, in place of a cost."""

    target_kind: ClassVar[TargetKind] = "none"
    joint: ClassVar[bool] = False
    """Whether J is the identity: the weight then goes onto the Hessian, and there are no rows."""

    @property
    def rows(self) -> int:
        """Number of rows of the error."""
        return self.weight.shape[0]

    @cached_property
    def diagonal(self) -> Array:
        """B's diagonal (rows,)."""
        return self.weight if self.weight.ndim == 1 else np.diagonal(self.weight)

    decisive: ClassVar[bool] = False
    """Whether the error must be within tolerance for a run to have converged."""

    @property
    def clamps(self) -> tuple[tuple[slice, float], ...]:
        """Parts of the rows, and the largest error that each acts on; e itself stays true."""
        return ()

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the true errors that `measure` returns; empty where there is none."""
        return ()

    @property
    def unit_rows(self) -> tuple[NDArray[np.intp], ...]:
        """The rows of the error that each of `units` is of; of a joint term those with a weight."""
        rows = np.flatnonzero(self.diagonal) if self.joint else np.arange(self.rows)
        return (rows,) * len(self.units)

    def measure(self, error: Array) -> Array:
        """Return the true errors, in `units`, that the error vector e (rows,) stands for."""
        return np.array([np.sqrt(error @ error)])[: len(self.units)]

    def after(self, error: Array, v_previous: Array, v: Array) -> Array:
        """Return the error (rows,) that is reported of a step from v_previous to v (nv,)."""
        return error

    def attainable(self, error: Array, rate: Array) -> Array:
        """Return ẋ (rows,) at e (rows,) without what J v is at right angles to by definition."""
        return rate

    def within(self, lower: Array, upper: Array) -> "Term":
        """Return the term for joints with the ranges [lower, upper] (nv,)."""
        return self

    def without(self, objects: Objects, start: Array) -> "Term":
        """Return the term of the robot alone, at the start configuration (nq,).

        Raises:
            FieldError: If nothing is left of it.
        """
        if not (self.joint and objects.roots):
            return self
        weight = self.weight.copy()
        weight[objects.dofs] = 0.0
        if weight.ndim == 2:
            weight[:, objects.dofs] = 0.0
        return replace(self, weight=weight)

    @classmethod
    @abstractmethod
    def evaluator(cls, terms: "Sequence[Term]", evaluation: "Evaluation") -> "Evaluator":
        """Return what evaluates all the terms of this class in a problem."""


class BendingTerm(Term):
    """A term whose e bends with the joints and draws the robot to a target: X has a part of it."""

    @abstractmethod
    def way(self, model: mujoco.MjModel) -> "Way":
        """Return the dofs that move the frame, in their order."""

    @abstractmethod
    def pull(self, evaluation: "Evaluation", pulled: Array) -> "Pull":
        """Return what the task does to its frame at B ẋ (rows,), at the present evaluation."""


class Way(NamedTuple):
    """The dofs that move something, in an order in which none comes before what it is moved by."""

    dofs: list[int]
    before: list[int]
    """The place in `dofs` of the one that comes right before each, −1 for none."""

    @classmethod
    def chain(cls, dofs: list[int]) -> "Way":
        """Return dofs one after the other."""
        return cls(dofs, list(range(-1, len(dofs) - 1)))

    def within(self, dofs: Collection[int]) -> "Way":
        """Return the same without the dofs that are not among these."""
        kept, before, place = [], [], []
        for dof, last in zip(self.dofs, self.before, strict=True):
            after = place[last] if last >= 0 else -1
            if dof in dofs:
                kept.append(dof)
                before.append(after)
                after = len(kept) - 1
            place.append(after)
        return Way(kept, before)


class Pull(NamedTuple):
    """A force and a torque on a frame, and how the dofs move it, in the world's axes.

    Jᵀ(B ẋ) is linearᵀ force + angularᵀ torque.
    """

    linear: Array
    """Velocities of the frame's origin (3, nv)."""
    angular: Array
    """Its angular velocities (3, nv)."""
    force: Array
    torque: Array
    distance: float = math.inf
    """m, of the point about which the force turns as the frame's origin moves."""


@dataclass(frozen=True, eq=False, kw_only=True)
class JointTerm(Term):
    """A term on the joints themselves, with errors of their own: metres and radians apart."""

    joint: ClassVar[bool] = True
    per: ClassVar[str] = ""
    """What a unit is per, as "/s"."""

    turning: NDArray[np.bool_]
    """Which dofs turn, not shift (nv,)."""

    @cached_property
    def _parts(self) -> tuple[tuple[str, NDArray[np.intp]], ...]:
        """The units, and the dofs with a weight that each is of; at least one."""
        weighed = self.diagonal > 0.0
        shifts = np.flatnonzero(weighed & ~self.turning)
        turns = np.flatnonzero(weighed & self.turning)
        parts = (("m" + self.per, shifts), ("rad" + self.per, turns))
        return tuple(part for part in parts if part[1].size) or (parts[1],)

    @property
    def units(self) -> tuple[str, ...]:
        """The norm over the joints that shift, and over those that turn, where there are any."""
        return tuple(unit for unit, _ in self._parts)

    @property
    def unit_rows(self) -> tuple[NDArray[np.intp], ...]:
        """The dofs of each unit that have a weight."""
        return tuple(rows for _, rows in self._parts)

    def measure(self, error: Array) -> Array:
        """Return the norms of the error over the joints that have a weight, a unit each."""
        return np.array([math.sqrt(error[rows] @ error[rows]) for _, rows in self._parts])


class RowlessTerm(Term):
    """A term without an error: it acts on the limits or on the metric."""

    @classmethod
    def evaluator(cls, terms: "Sequence[Term]", evaluation: "Evaluation") -> "Evaluator":
        """Return what does nothing: there is nothing to evaluate."""
        return lambda: None


class Evaluator(Protocol):
    """Writes J, e and the feed-forward of some terms into their rows of an `Evaluation`."""

    def __call__(self) -> None:
        """Evaluate at the configuration's present kinematics."""
        ...


def weight_array(weight: object, rows: int, key: str = "B") -> Array:
    """Return a weight as a diagonal (rows,) or a matrix (rows, rows).

    Raises:
        FieldError: If its size is not the task's.
    """
    array = np.asarray(weight, dtype=float)
    if array.ndim == 0:
        return np.full(rows, float(array))
    if array.shape[0] != rows:
        raise FieldError(key, f"this task has {rows} rows, and B has {array.shape[0]}")
    return array


def square_root(weight: Array) -> Array:
    """Return S with B = SᵀS: of a diagonal element by element, of a matrix by its eigenvectors."""
    if weight.ndim == 1:
        return np.sqrt(weight)
    values, vectors = np.linalg.eigh(weight)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def gain_value(gain: float | str) -> float:
    """Return K in 1/s; `deadbeat` is infinite here and 1/dt in the step."""
    return np.inf if isinstance(gain, str) else gain
