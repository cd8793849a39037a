"""Terms that one of mink's own task objects evaluates."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mink
import numpy as np

from rmrc.model.carrier import Carrier
from rmrc.model.frames import FrameHandle
from rmrc.tasks.base import Array, Term

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


@dataclass(frozen=True, eq=False, kw_only=True)
class MinkTerm(Term):
    """A term whose error and Jacobian come from a mink task of unit cost and gain."""

    @abstractmethod
    def task(self) -> mink.Task:
        """Return a fresh mink task; each engine sets targets on one of its own."""

    @abstractmethod
    def aim(self, task: mink.Task, target: Array) -> None:
        """Hand the target to the mink task."""

    def linearize(
        self, task: mink.Task, configuration: mink.Configuration, target: Array
    ) -> tuple[Array, Array]:
        """Return J (rows, nv) and e (rows,), by mink's task where it is right."""
        jacobian, error, _ = task.compute_qp_residual(configuration)
        return jacobian, error

    @abstractmethod
    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return ẋ_ff (rows,) for the target's velocity `twist`."""

    @property
    @abstractmethod
    def frames(self) -> tuple[FrameHandle, ...]:
        """The frames that the error is between."""

    @abstractmethod
    def carry(
        self,
        configuration: mink.Configuration,
        error: Array,
        target: Array,
        twists: Sequence[Array],
    ) -> Array:
        """Return ẋ_ff (rows,) for the velocities of the frames (6,), each along its own axes."""

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        return _MinkEvaluator([t for t in terms if isinstance(t, MinkTerm)], evaluation)


class _MinkEvaluator:
    """Evaluates mink tasks in turn; with unit cost and gain their residual is (J, −e)."""

    def __init__(self, terms: Sequence[MinkTerm], evaluation: "Evaluation"):
        self._configuration = evaluation.configuration
        self._moving = evaluation.moving
        self._entries = []
        model, data = evaluation.model, evaluation.data
        for term in terms:
            rows = evaluation.rows_of([term])
            carriers = [evaluation.carrier(frame.body(model)) for frame in term.frames]
            carried = [
                (carrier, *frame.views(data))
                for carrier, frame in zip(carriers, term.frames, strict=True)
            ]
            self._entries.append(
                (
                    term,
                    evaluation.index[term.name],
                    term.task(),
                    evaluation.target[term.name],
                    evaluation.jacobian[rows],
                    evaluation.error[rows],
                    evaluation.feedforward[rows],
                    evaluation.twist[term.name],
                    carried if any(carriers) else [],
                )
            )

    def __call__(self) -> None:
        configuration = self._configuration
        for term, index, task, target, jacobian, error, feed, twist, carried in self._entries:
            term.aim(task, target)
            jacobian[:], error[:] = term.linearize(task, configuration, target)
            if self._moving[index]:
                feed[:] = term.feed_forward(configuration, error, target, twist)
            elif carried:
                feed[:] = 0.0
            if carried:
                twists = [_velocity(*each) for each in carried]
                feed += term.carry(configuration, error, target, twists)


def _velocity(carrier: Carrier | None, position: Array, matrix: Array) -> Array:
    """Return the velocity (6,) of a frame along its own axes, as its carrier moves it."""
    if carrier is None:
        return np.zeros(6)
    return (carrier.velocity(position).reshape(2, 3) @ matrix.reshape(3, 3)).ravel()
