"""The `com` task: the centre of mass follows a target point."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import mujoco
import numpy as np

from rmrc.config.base import NameOf, Positive
from rmrc.problem.frames import find
from rmrc.problem.tasks.base import (
    Array,
    GainedTask,
    TargetKind,
    Term,
    WeightedTask,
    gain_value,
    weight_array,
)

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class ComTask(GainedTask, WeightedTask):
    """Bring the centre of mass of the robot to a target point in the world."""

    target_kind: ClassVar[TargetKind] = "point"

    type: Literal["com"] = "com"
    body: Annotated[str, NameOf("body")] | None = None
    """Body whose subtree is meant; by default the whole robot."""
    clamp: Positive | None = None
    """Largest error in m that the task acts on."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "ComTerm":
        """Find the subtree; the target is its centre of mass at the start."""
        weight = weight_array(self.B, 3)
        body = robot_root(model) if self.body is None else find(model, "body", self.body)
        data = mujoco.MjData(model)
        data.qpos = start
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        return ComTerm(
            name=self.name,
            type=self.type,
            level=self.level,
            gain=gain_value(self.gain),
            weight=weight,
            target=data.subtree_com[body].copy(),
            body=body,
            clamp=self.clamp or np.inf,
        )


def robot_root(model: mujoco.MjModel) -> int:
    """Return the one child of the world that has joints in its subtree, or the world itself.

    Mocap targets and furniture have none; body 1, which mink takes, may well be one of them.
    """
    moving = {int(model.body_rootid[body]) for body in model.dof_bodyid}
    return moving.pop() if len(moving) == 1 else 0


@dataclass(frozen=True, eq=False, kw_only=True)
class ComTerm(Term):
    """Rows of a `com` task: e = c* − c(q) and J = ∂c/∂q, in the world's axes."""

    target_kind: ClassVar[TargetKind] = "point"
    decisive: ClassVar[bool] = True

    body: int
    clamp: float

    @property
    def units(self) -> tuple[str, ...]:
        """The distance."""
        return ("m",)

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        return _ComEvaluator([t for t in terms if isinstance(t, ComTerm)], evaluation)


class _ComEvaluator:
    """Evaluates every `com` term with MuJoCo's subtree Jacobian."""

    def __init__(self, terms: Sequence[ComTerm], evaluation: "Evaluation"):
        self._model, self._data = evaluation.model, evaluation.data
        self._moving = evaluation.moving
        self._entries = []
        for term in terms:
            rows = evaluation.rows_of([term])
            self._entries.append(
                (
                    term,
                    self._data.subtree_com[term.body],
                    evaluation.target[term.name],
                    evaluation.jacobian[rows],
                    evaluation.error[rows],
                    evaluation.feedforward[rows],
                    evaluation.twist[term.name],
                )
            )

    def __call__(self) -> None:
        for term, com, target, jacobian, error, feedforward, twist in self._entries:
            mujoco.mj_jacSubtreeCom(self._model, self._data, jacobian, term.body)
            np.subtract(target, com, out=error)
            if term.clamp < np.inf:
                length = float(np.sqrt(error @ error))
                if length > term.clamp:
                    error *= term.clamp / length
            if term.name in self._moving:
                feedforward[:] = twist[:3]
