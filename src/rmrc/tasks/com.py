"""The `com` task: the centre of mass follows a target point."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import mujoco
import numpy as np

from rmrc.model.extents import dofs_of_bodies
from rmrc.model.frames import find
from rmrc.model.objects import Objects
from rmrc.tasks.base import (
    Array,
    BendingTerm,
    FieldError,
    GainedTask,
    HardTask,
    Pull,
    TargetKind,
    Term,
    Way,
    WeightedTask,
    weight_array,
)
from rmrc.text.annotations import NameOf
from rmrc.text.base import Positive

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


class ComTask(HardTask, GainedTask, WeightedTask):
    """Bring the centre of mass of the robot to a target point in the world."""

    target_kind: ClassVar[TargetKind] = "point"

    type: Literal["com"] = "com"
    body: Annotated[str, NameOf("body")] | None = None
    """Body whose subtree is meant; by default the whole robot. Objects are never a part of it."""
    clamp: Positive | None = None
    """Largest error in m that the task acts on."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the body whose subtree is meant."""
        return [] if self.body is None else [find(model, "body", self.body)]

    def compile(self, model: mujoco.MjModel, start: Array) -> "ComTerm":
        """Find the subtree; the target is its centre of mass at the start."""
        weight = weight_array(self.B, 3)
        roots = robot_roots(model) if self.body is None else (find(model, "body", self.body),)
        if roots == (0,):
            roots = tuple(np.flatnonzero(model.body_parentid == 0)[1:].tolist())
        shares, target = _mass_shares(model, start, roots)
        return ComTerm(
            **self.common(),
            weight=weight,
            target=target,
            shares=shares,
            clamp=self.clamp or np.inf,
        )


def body_is_in(model: mujoco.MjModel, body: int, root: int) -> bool:
    """Return whether a body is in the subtree of another."""
    while body > root:
        body = int(model.body_parentid[body])
    return body == root


def _mass_shares(
    model: mujoco.MjModel, start: Array, roots: Sequence[int]
) -> tuple[tuple[tuple[int, float], ...], Array]:
    """Return subtrees with their shares of the mass, and their centre of mass at the start (3,).

    Raises:
        FieldError: If they have no mass.
    """
    mass = model.body_subtreemass[list(roots)]
    if not mass.sum() > 0.0:
        raise FieldError("body", "what is meant has no mass")
    data = mujoco.MjData(model)
    data.qpos = start
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    share = mass / mass.sum()
    return tuple(zip(roots, share.tolist(), strict=True)), share @ data.subtree_com[list(roots)]


def robot_roots(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the children of the world that have joints in their subtree: the robots.

    Furniture and mocap targets have none; body 1, which mink takes, may well be one of them.
    """
    return tuple(sorted({int(model.body_rootid[body]) for body in model.dof_bodyid}))


@dataclass(frozen=True, eq=False, kw_only=True)
class ComTerm(BendingTerm):
    """Rows of a `com` task: e = c* − c(q) and J = ∂c/∂q, in the world's axes.

    c = Σ m_i c_i / Σ m_i over the subtrees of several robots.
    """

    target_kind: ClassVar[TargetKind] = "point"
    decisive: ClassVar[bool] = True

    shares: tuple[tuple[int, float], ...]
    """The bodies whose subtrees count, and each one's share of the mass."""
    clamp: float
    """Largest error that the task acts on, m; infinite without one."""

    @property
    def clamps(self) -> tuple[tuple[slice, float], ...]:
        """The whole error, where it has a clamp."""
        return ((slice(3), self.clamp),) if self.clamp < np.inf else ()

    def way(self, model: mujoco.MjModel) -> Way:
        """Return the dofs that move a part of the mass, as a tree."""
        roots = [root for root, share in self.shares if share]
        moves = dofs_of_bodies(model)
        above = moves[roots].any(axis=0)
        inside = np.array(
            [any(body_is_in(model, body, root) for root in roots) for body in model.dof_bodyid]
        )
        everything = Way(list(range(model.nv)), model.dof_parentid.tolist())
        return everything.within(set(np.flatnonzero(above | inside).tolist()))

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return the force on the centre of mass; u_j takes no torque."""
        linear = evaluation.jacobian[evaluation.rows_of([self])]
        return Pull(linear, np.zeros_like(linear), pulled, np.zeros(3))

    @property
    def units(self) -> tuple[str, ...]:
        """The distance."""
        return ("m",)

    def without(self, objects: Objects, start: Array) -> "ComTerm":
        """Return the term with the mass of the robot alone."""
        roots = [root for root, _ in self.shares if not objects.bodies[root]]
        if len(roots) == len(self.shares):
            return self
        shares, target = _mass_shares(objects.model, start, roots)
        return replace(self, shares=shares, target=target)

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        return _ComEvaluator([t for t in terms if isinstance(t, ComTerm)], evaluation)


class _ComEvaluator:
    """Evaluates every `com` term with MuJoCo's subtree Jacobians."""

    def __init__(self, terms: Sequence[ComTerm], evaluation: "Evaluation"):
        self._model, self._data = evaluation.model, evaluation.data
        self._moving = evaluation.moving
        self._part = np.zeros((3, self._model.nv))
        self._entries = []
        for term in terms:
            rows = evaluation.rows_of([term])
            self._entries.append(
                (
                    term,
                    evaluation.index[term.name],
                    evaluation.target[term.name],
                    evaluation.jacobian[rows],
                    evaluation.error[rows],
                    evaluation.feedforward[rows],
                    evaluation.twist[term.name],
                    [
                        (body, share, carrier)
                        for body, share in term.shares
                        if (carrier := evaluation.carrier(body)) is not None
                    ],
                )
            )

    def __call__(self) -> None:
        com = self._data.subtree_com
        for term, index, target, jacobian, error, feed, twist, carried in self._entries:
            if len(term.shares) == 1:
                body = term.shares[0][0]
                mujoco.mj_jacSubtreeCom(self._model, self._data, jacobian, body)
                np.subtract(target, com[body], out=error)
            else:
                error[:], jacobian[:] = target, 0.0
                for body, share in term.shares:
                    mujoco.mj_jacSubtreeCom(self._model, self._data, self._part, body)
                    jacobian += share * self._part
                    error -= share * com[body]
            if self._moving[index]:
                feed[:] = twist[:3]
            elif carried:
                feed[:] = 0.0
            for body, share, carrier in carried:
                feed -= share * carrier.velocity(com[body])[:3]
