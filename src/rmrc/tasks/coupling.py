"""The `coupling` task: a linear relation between joints."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco
import numpy as np
from pydantic import Field, model_validator

from rmrc.model.configuration import QPOS_WIDTH, joint_type
from rmrc.model.frames import FrameHandle, find, resolve
from rmrc.model.objects import bodies_of_joints
from rmrc.tasks.base import (
    Array,
    ConstraintTask,
    FieldError,
    Term,
    weight_array,
)
from rmrc.text.base import (
    Frame,
    FrameName,
    JointName,
    Model,
    NonNegative,
    Number,
    Vector3,
)

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class BodyRates(Model):
    """Coefficients of a frame's velocity, along and about its own axes."""

    linear: Vector3 = (0.0, 0.0, 0.0)
    """Of its linear velocity along x, y, z."""
    angular: Vector3 = (0.0, 0.0, 0.0)
    """Of its angular velocity about x, y, z."""


class CouplingTask(ConstraintTask):
    """Hold a linear relation: Σ c_i q_i = offset between hinges and slides, or Σ c_i ν_i = 0
    between the velocities ν of a frame in its own axes, as of wheels that do not slide sideways.
    """

    type: Literal["coupling"] = "coupling"
    B: NonNegative = 1.0
    """Weight of the squared residual where the task is not `hard`, a number."""
    coefficients: dict[JointName, Number] = Field(default={})
    """c by joint, for q in rad or m."""
    frame: FrameName | None = None
    """The frame whose velocities `rates` relates."""
    rates: BodyRates | None = None
    """c of the frame's velocity in its own axes, as {linear: [0, 1, 0]} for one that cannot move
    along its y."""
    offset: Number = 0.0
    """What the sum is held at, in the unit of its terms."""

    @model_validator(mode="after")
    def _one_kind(self) -> "CouplingTask":
        if (self.frame is None) != (self.rates is None):
            raise ValueError("frame and rates belong together: name both or neither")
        if self.coefficients and self.rates is not None:
            raise ValueError("give either coefficients of joints, or frame and rates")
        return self

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints, or that of the frame."""
        if self.frame is not None:
            return [resolve(model, self.frame).body(model)]
        return bodies_of_joints(model, self.coefficients)

    def compile(self, model: mujoco.MjModel, start: Array) -> "CouplingTerm | RateTerm":
        """Resolve the joints or the frame.

        Raises:
            FieldError: If a joint is no hinge or slide, every coefficient is zero, or no joint
                moves the frame.
        """
        if self.frame is not None and self.rates is not None:
            return self._of_rates(model, start, self.frame, self.rates)
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

    def _of_rates(
        self, model: mujoco.MjModel, start: Array, frame: Frame, rates: BodyRates
    ) -> "RateTerm":
        handle, numbers = resolve(model, frame), np.array([*rates.linear, *rates.angular])
        if not numbers.any():
            raise FieldError(
                "rates", "name at least one velocity, with a coefficient that is not 0"
            )
        if not handle.dofs(model):
            raise FieldError("frame", f"no joint moves the {handle.kind} '{frame.name}'")
        return RateTerm(
            **self.common(),
            weight=weight_array(self.B, 1),
            target=start[:0],
            frame=handle,
            coefficients=numbers,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class RateTerm(Term):
    """A `coupling` of rates: e = 0 and J = cᵀ [Rᵀ J_p; Rᵀ J_r] of a frame with the rotation R."""

    frame: FrameHandle
    coefficients: Array
    """c (6,), linear and angular."""

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one; a joint velocity breaks them, and never a position."""
        couplings = [term for term in terms if isinstance(term, RateTerm)]
        rows = evaluation.rows_of(couplings)
        jacobian, model, data = evaluation.jacobian[rows], evaluation.model, evaluation.data
        evaluation.error[rows] = 0.0
        linear, angular = np.zeros((2, 3, model.nv))

        def evaluate() -> None:
            for row, term in zip(jacobian, couplings, strict=True):
                term.frame.jacobian(model, data, linear, angular, term.frame.id)
                rotation = term.frame.views(data)[1].reshape(3, 3)
                along, about = term.coefficients.reshape(2, 3) @ rotation.T
                row[:] = along @ linear + about @ angular

        return evaluate


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
