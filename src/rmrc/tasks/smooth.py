"""The `smooth` task: the joint velocity changes little from step to step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco

from rmrc.tasks.base import Array, Term, WeightedTask, weight_array

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class SmoothTask(WeightedTask):
    """Keep the joint velocity near that of the step before: ‖v − v_prev‖²."""

    type: Literal["smooth"] = "smooth"

    def compile(self, model: mujoco.MjModel, start: Array) -> "SmoothTerm":
        """Take the weight over all dofs."""
        return SmoothTerm(
            **self.common(),
            weight=weight_array(self.B, model.nv),
            target=start[:0],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothTerm(Term):
    """A `smooth` task: ẋ = v_prev, J = I."""

    joint: ClassVar[bool] = True

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        previous = evaluation.v_previous
        entries = [evaluation.feedforward[evaluation.rows_of([term])] for term in terms]

        def evaluate() -> None:
            for feedforward in entries:
                feedforward[:] = previous

        return evaluate
