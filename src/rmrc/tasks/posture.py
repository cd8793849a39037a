"""The `posture` task: the joints go to a target configuration."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.configuration import free_dofs, resolve_configuration, turning_dofs
from rmrc.model.objects import bodies_of_joints
from rmrc.tasks.base import (
    Array,
    FieldError,
    GainedTask,
    HardTask,
    JointTerm,
    TargetKind,
    Term,
    WeightedTask,
    weight_array,
)
from rmrc.text.base import JointName, KeyframeName, Number, Vector, Weight

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


_NONE = np.zeros(0, dtype=np.intp)


class PostureTask(HardTask, GainedTask, WeightedTask):
    """Bring the joints to a target configuration; a floating base is left alone."""

    target_kind: ClassVar[TargetKind] = "configuration"

    type: Literal["posture"] = "posture"
    B: Weight = 0.01
    """Weight of the squared error, Whitney's B: a number, a diagonal or a symmetric matrix. One
    level down it is small enough to leave a `frame` of the default weight at its target."""
    target: KeyframeName | Vector | dict[JointName, Number] | None = None
    """A keyframe, all of qpos, or {joint: value} on the start; by default the start itself."""
    wrap: bool = False
    """Whether hinges without a range take the short way round, with errors in (−π, π]."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints that the target names."""
        return bodies_of_joints(model, self.target if isinstance(self.target, dict) else ())

    def compile(self, model: mujoco.MjModel, start: Array) -> "PostureTerm":
        """Resolve the target configuration and take the floating base out of the weight."""
        weight = weight_array(self.B, model.nv)
        free = free_dofs(model)
        weight[free] = 0.0
        if weight.ndim == 2:
            weight[:, free] = 0.0
        try:
            target = resolve_configuration(model, self.target, start)
        except ValueError as mistake:
            raise FieldError("target", str(mistake)) from None
        return PostureTerm(
            **self.common(),
            weight=weight,
            target=target,
            turning=turning_dofs(model),
            wrapped=_endless(model) if self.wrap else _NONE,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PostureTerm(JointTerm):
    """A `posture` task: e = q* ⊖ q on the manifold, J = I."""

    target_kind: ClassVar[TargetKind] = "configuration"

    wrapped: NDArray[np.intp] = field(default_factory=lambda: _NONE)
    """The dofs whose error is taken in (−π, π]."""

    def within(self, lower: Array, upper: Array) -> "PostureTerm":
        """Return the term that wraps only what has no range [lower, upper] (nv,) either."""
        ranged = np.isfinite(lower) | np.isfinite(upper)
        return replace(self, wrapped=self.wrapped[~ranged[self.wrapped]])

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        model, qpos = evaluation.model, evaluation.data.qpos
        entries = [
            (evaluation.error[evaluation.rows_of([t])], evaluation.target[t.name], t.wrapped)
            for t in terms
            if isinstance(t, PostureTerm)
        ]

        def evaluate() -> None:
            for error, target, wrapped in entries:
                mujoco.mj_differentiatePos(model, error, 1.0, qpos, target)
                turns = np.ceil((error[wrapped] - math.pi) / (2.0 * math.pi))
                error[wrapped] -= 2.0 * math.pi * turns

        return evaluate


def _endless(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the dofs of the hinges that have no range in the model."""
    endless = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_limited == 0)
    return model.jnt_dofadr[endless].astype(np.intp)
