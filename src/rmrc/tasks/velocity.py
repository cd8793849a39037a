"""The `velocity` task: the joints track given rates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco
import numpy as np

from rmrc.model.configuration import dof_of_joint, turning_dofs
from rmrc.model.objects import bodies_of_joints
from rmrc.tasks.base import (
    Array,
    FieldError,
    HardTask,
    JointTerm,
    TargetKind,
    Term,
    WeightedTask,
    weight_array,
)
from rmrc.text.base import JointName, Number

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class VelocityTask(HardTask, WeightedTask):
    """Track joint rates; joints that are not named are left alone."""

    target_kind: ClassVar[TargetKind] = "rates"

    type: Literal["velocity"] = "velocity"
    target: dict[JointName, Number]
    """Rates by joint, rad/s or m/s."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints."""
        return bodies_of_joints(model, self.target)

    def compile(self, model: mujoco.MjModel, start: Array) -> "VelocityTerm":
        """Resolve the joints; a number B weighs those named, a list or a matrix all dofs."""
        if not self.target:
            raise FieldError("target", "name at least one joint and its rate")
        rates = np.zeros(model.nv)
        named = np.zeros(model.nv, dtype=bool)
        for joint, rate in self.target.items():
            dof = dof_of_joint(model, joint)
            rates[dof], named[dof] = rate, True
        weight = weight_array(self.B, model.nv)
        weight[~named] = 0.0
        if weight.ndim == 2:
            weight[:, ~named] = 0.0
        return VelocityTerm(
            **self.common(),
            weight=weight,
            target=rates,
            turning=turning_dofs(model),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class VelocityTerm(JointTerm):
    """A `velocity` task: ẋ = v*, J = I, e = v* − v_prev; the error of a step is v* − v."""

    target_kind: ClassVar[TargetKind] = "rates"
    per: ClassVar[str] = "/s"

    def after(self, error: Array, v_previous: Array, v: Array) -> Array:
        """Return v* − v: that of the step itself, not of the one before."""
        return error + v_previous - v

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        previous = evaluation.v_previous
        entries = [
            (
                evaluation.error[evaluation.rows_of([t])],
                evaluation.feedforward[evaluation.rows_of([t])],
                evaluation.target[t.name],
            )
            for t in terms
        ]

        def evaluate() -> None:
            for error, feedforward, target in entries:
                np.subtract(target, previous, out=error)
                feedforward[:] = target

        return evaluate
