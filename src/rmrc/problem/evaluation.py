"""`Evaluation`: errors and Jacobians of all terms at one configuration, in buffers kept."""

from collections.abc import Callable, Iterable, Sequence
from math import isfinite
from typing import NamedTuple

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.carrier import Carrier, carrier_of
from rmrc.problem.problem import Problem
from rmrc.tasks.base import Evaluator, Term

Array = NDArray[np.float64]


class Kept(NamedTuple):
    """The error of a step, and what it depended on beside q and v_prev."""

    error: Array
    targets: Array
    moving: tuple[bytes, Array] | None
    """Which targets move and the twists; None where none does."""
    obstacles: tuple[Array, Array, Array] | None
    """Positions, quaternions and velocities of the mocap bodies; None without any."""


class Evaluation:
    """Stacks e, ẋ_ff and J of a problem's terms.

    Terms with rows come first, those of one class together, then the terms on the joints
    themselves (`Term.joint`), whose J is the identity and is not stored.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        self.model = problem.model
        self.configuration = mink.Configuration(problem.model, problem.start)
        self.data = self.configuration.data
        self._mink = bool(problem.mink_tasks or problem.mink_limits)
        present = [term for term in problem.terms if term.rows]
        classes = list(dict.fromkeys(type(t) for t in sorted(present, key=lambda t: t.joint)))
        groups = [[t for t in present if type(t) is kind] for kind in classes]
        self.terms: tuple[Term, ...] = tuple(term for group in groups for term in group)
        """The terms that have an error, in the order of their rows."""
        ends = np.cumsum([0, *(term.rows for term in self.terms)])
        self._slices = {
            term.name: slice(int(a), int(b))
            for term, a, b in zip(self.terms, ends[:-1], ends[1:], strict=True)
        }
        self.row_count = sum(term.rows for term in self.terms if not term.joint)
        self.jacobian = np.zeros((self.row_count, problem.model.nv))
        """J of the terms with rows (row_count, nv)."""
        self.error = np.zeros(int(ends[-1]))
        """e of all terms."""
        self.feedforward = np.zeros(int(ends[-1]))
        """ẋ_ff of all terms."""
        self.v_previous = np.zeros(problem.model.nv)
        """The velocity of the step before (nv,)."""
        self.a_previous = np.zeros(problem.model.nv)
        """The acceleration of the step before (nv,)."""
        self.obstacle_twist = np.zeros((problem.model.nmocap, 6))
        """Velocities of the mocap bodies, linear and angular in the world (nmocap, 6)."""
        targets = [term.target for term in problem.terms]
        cuts = np.cumsum([target.size for target in targets[:-1]])
        self.targets = np.concatenate(targets)
        """All targets one after another, so that one copy keeps them."""
        names = [term.name for term in problem.terms]
        self.target = dict(zip(names, np.split(self.targets, cuts), strict=True))
        """Present targets by task: wxyz + xyz, a point, a direction, qpos or rates."""
        self.twists = np.zeros((len(names), 6))
        self.twist = dict(zip(names, self.twists, strict=True))
        """Velocities of the targets (6,), in the axes that their positions are given in."""
        self.index = {name: k for k, name in enumerate(names)}
        """The tasks' places in `twists` and `moving`."""
        self.moving = bytearray(len(names))
        """1 for each task whose target moves: beside what mocap bodies carry, the only ones with a
        feed-forward."""
        self.evaluators: dict[type[Term], Evaluator] = {
            kind: kind.evaluator(group, self) for kind, group in zip(classes, groups, strict=True)
        }
        """What evaluates the terms of each class."""
        self.refused: list[str] = []
        """What could not be used at the last evaluation, and why: a step then brakes."""

    def carrier(self, body: int) -> Carrier | None:
        """Return the mocap body that carries a body, if there is one."""
        return carrier_of(self.model, self.data, self.obstacle_twist, body)

    def rows_of(self, terms: Sequence[Term]) -> slice:
        """Return the rows of e that a run of neighbouring terms fills."""
        return slice(self._slices[terms[0].name].start, self._slices[terms[-1].name].stop)

    def error_of(self, error: Array, term: Term) -> Array:
        """Return one term's part of an error vector."""
        return error[self._slices[term.name]]

    def update(self, q: Array) -> None:
        """Run the kinematics at q (nq,)."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        self.fill_constraints()

    def fill_constraints(self) -> None:
        """Fill what tasks of mink's read of the model's equalities, after the kinematics."""
        if self._mink and self.model.neq:
            mujoco.mj_tendon(self.model, self.data)
            mujoco.mj_makeConstraint(self.model, self.data)

    def obstacles(self) -> tuple[Array, Array, Array]:
        """Return copies of the mocap bodies' positions, quaternions and velocities."""
        data = self.data
        return data.mocap_pos.copy(), data.mocap_quat.copy(), self.obstacle_twist.copy()

    def keep(self) -> Kept:
        """Return copies of the error, the targets and the mocap bodies as they are."""
        moving = (bytes(self.moving), self.twists.copy()) if 1 in self.moving else None
        obstacles = self.obstacles() if self.model.nmocap else None
        return Kept(self.error.copy(), self.targets.copy(), moving, obstacles)

    def restore(self, kept: Kept) -> None:
        """Put the targets and the mocap bodies where they were."""
        self.targets[:], self.feedforward[:] = kept.targets, 0.0
        self.moving[:] = bytes(len(self.moving))
        if kept.moving is not None:
            self.moving[:], self.twists[:] = kept.moving
        if kept.obstacles is not None:
            data = self.data
            data.mocap_pos[:], data.mocap_quat[:], self.obstacle_twist[:] = kept.obstacles

    def move(self, q: Array, dofs: NDArray[np.intp], step: Array) -> None:
        """Evaluate at q moved by a tangent step over some dofs."""
        moved, tangent = q.copy(), np.zeros(self.model.nv)
        tangent[dofs] = step
        mujoco.mj_integratePos(self.model, moved, tangent, 1.0)
        self.update(moved)
        self.evaluate()

    def evaluate(self) -> None:
        """Evaluate every term at the present kinematics and targets."""
        self.run(self.evaluators.items())

    def run(self, evaluators: Iterable[tuple[type[Term], Evaluator]]) -> None:
        """Evaluate the terms of some classes, and refuse what is not finite."""
        self.refused.clear()
        for kind, evaluate in evaluators:
            self.attempt(kind.__name__, evaluate)
        parts = (self.error, self.feedforward, self.jacobian)
        # A sum of squares is finite only if all of them are.
        if not all(isfinite(np.vdot(part, part)) for part in parts):
            for term in self.terms:
                rows = self.rows_of([term])
                if not all(np.isfinite(part[rows]).all() for part in parts):
                    self.refused.append(f"{term.name}: its error or its Jacobian is not finite")

    def attempt(self, name: str, action: Callable[..., None], *arguments: object) -> None:
        """Do what somebody else's code has a part in; what it raises is refused, whatever it is."""
        try:
            action(*arguments)
        except Exception as failure:
            self.refused.append(f"{name}: {failure or type(failure).__name__}")

    def stop(self, name: str) -> None:
        """Forget the velocity of a task's target."""
        if self.moving[self.index[name]]:
            self.moving[self.index[name]] = 0
            self.feedforward[self._slices[name]] = 0.0
