"""The `coupling` task: a linear relation between joints."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco
import numpy as np

from rmrc.config.base import JointName, NonNegative, Number
from rmrc.problem.configuration import QPOS_WIDTH, joint_type
from rmrc.problem.frames import find
from rmrc.problem.objects import bodies_of_joints
from rmrc.problem.tasks.base import (
    Array,
    ConstraintTask,
    FieldError,
    Term,
    weight_array,
)

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class CouplingTask(ConstraintTask):
    """Hold a linear relation Σ c_i q_i = offset between hinges and slides."""

    type: Literal["coupling"] = "coupling"
    B: NonNegative = 1.0
    """Weight of the squared residual where the task is not `hard`, a number."""
    coefficients: dict[JointName, Number]
    """c by joint, for q in rad or m."""
    offset: Number = 0.0
    """What the sum is held at, in the unit of its terms."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints."""
        return bodies_of_joints(model, self.coefficients)

    def compile(self, model: mujoco.MjModel, start: Array) -> "CouplingTerm":
        """Resolve the joints.

        Raises:
            FieldError: If a joint is no hinge or slide, or every coefficient is zero.
        """
        by_coordinate, by_dof = np.zeros(model.nq), np.zeros(model.nv)
        slides = False
        for name, coefficient in self.coefficients.items():
            joint = find(model, "joint", name)
            if QPOS_WIDTH[joint_type(model, joint)] != 1:
                raise FieldError("coefficients", f"joint '{name}' is no hinge or slide")
            by_coordinate[model.jnt_qposadr[joint]] = coefficient
            by_dof[model.jnt_dofadr[joint]] = coefficient
            slides |= joint_type(model, joint) == mujoco.mjtJoint.mjJNT_SLIDE
        if not by_dof.any():
            raise FieldError("coefficients", "name at least one joint and its coefficient, not 0")
        return CouplingTerm(
            **self.common(),
            weight=weight_array(self.B, 1),
            target=start[:0],
            by_coordinate=by_coordinate,
            by_dof=by_dof,
            offset=self.offset,
            unit="m" if slides else "rad",
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class CouplingTerm(Term):
    """A `coupling` task: e = offset − Σ c_i q_i and the one row J = c."""

    decisive: ClassVar[bool] = True

    by_coordinate: Array
    """c over qpos (nq,)."""
    by_dof: Array
    """c over the dofs (nv,)."""
    offset: float
    unit: str
    """m where a slide is among the joints, else rad."""

    @property
    def units(self) -> tuple[str, ...]:
        """The size of the residual."""
        return (self.unit,)

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Write J, which no configuration changes, and evaluate all terms by one product."""
        couplings = [term for term in terms if isinstance(term, CouplingTerm)]
        rows = evaluation.rows_of(couplings)
        evaluation.jacobian[rows] = [term.by_dof for term in couplings]
        matrix = np.array([term.by_coordinate for term in couplings])
        offset = np.array([term.offset for term in couplings])
        error, qpos = evaluation.error[rows], evaluation.data.qpos

        def evaluate() -> None:
            np.subtract(offset, matrix @ qpos, out=error)

        return evaluate
