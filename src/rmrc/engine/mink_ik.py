"""mink's own `solve_ik` as a method of a run, its tasks and limits made of the problem's."""

import copy
from typing import TYPE_CHECKING, Any

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.config.solvers import backend_of
from rmrc.limits.collision import CollisionPairs
from rmrc.limits.joints import held_ranges
from rmrc.model.configuration import joint_dofs, joint_type
from rmrc.problem.problem import Problem
from rmrc.tasks.axis_align import AxisAlignTerm
from rmrc.tasks.base import Term
from rmrc.tasks.com import ComTerm
from rmrc.tasks.frame import FrameTerm
from rmrc.tasks.freeze import FreezeTerm
from rmrc.tasks.kinetic_energy import KineticEnergyTerm
from rmrc.tasks.look_at import LookAtTerm
from rmrc.tasks.posture import PostureTerm
from rmrc.tasks.relative_frame import RelativeFrameTerm

if TYPE_CHECKING:
    from rmrc.engine.closed_form import Ask

Array = NDArray[np.float64]


class Unsolved(ValueError):
    """Somebody else's solver has given no command; the message says why."""


class MinkIK:
    """Solves a step as a loop of mink's user would: cost = √B, gain = K dt and damping = λ²."""

    def __init__(self, problem: Problem):
        made = [(term, task_of(term, problem)) for term in problem.terms]
        self._tasks = [(term, task) for term, task in made if task is not None]
        self._problem, self._limits = problem, _limits(problem)
        model, moving = problem.model, problem.dofs[problem.box.velocity > 0.0]
        held = np.setdiff1d(np.arange(model.nv), moving).tolist()
        self._constraints = [mink.DofFreezingTask(model, held)] if held else []

    def __call__(self, ask: "Ask") -> Array:
        """Return v (n,).

        Raises:
            Unsolved: If mink raises, as where no v keeps its limits.
        """
        problem, evaluation = self._problem, ask.evaluation
        try:
            for term, task in self._tasks:
                _set(task, evaluation.target[term.name], min(term.gain * ask.dt, 1.0))
            v = mink.solve_ik(
                evaluation.configuration,
                [*(task for _, task in self._tasks), *problem.mink_tasks],
                ask.dt,
                backend_of(problem.config.solver.backend),
                problem.damping**2,
                limits=self._limits,
                constraints=self._constraints,
            )
        except Exception as failure:  # mink's own errors, its solvers', and those of a user's task
            raise Unsolved(f"mink: {failure or type(failure).__name__}") from None
        return v[problem.dofs]


def task_of(term: Term, problem: Problem) -> BaseTask | None:
    """Return a task of mink's that stands for a term, None where it has none.

    A level's weights are multiplied by `soft_ratio`, as mink has no levels.
    """
    weight = term.weight if term.weight.ndim == 1 else np.diag(term.diagonal)
    if term.preserve or not np.array_equal(weight, term.weight):
        return None
    share = problem.config.soft_ratio**term.level
    cost = np.sqrt(share * term.diagonal)
    match term:
        case FrameTerm(frame=frame, axes="body"):
            return mink.FrameTask(frame.id, frame.kind, cost[:3], cost[3:])
        case RelativeFrameTerm(frame=frame, root=root):
            return mink.RelativeFrameTask(
                frame.id, frame.kind, root.id, root.kind, cost[:3], cost[3:]
            )
        case ComTerm(shares=((1, _),)):  # mink's is that of body 1, whatever it is
            return mink.ComTask(cost)
        case PostureTerm() if not term.wrapped.size:
            return mink.PostureTask(problem.model, cost)
        case LookAtTerm(frame=frame, axis=axis):
            return mink.LookAtTask(frame.id, frame.kind, axis, cost[:1])
        case AxisAlignTerm(frame=frame, axis=axis):
            return mink.AxisAlignTask(frame.id, frame.kind, axis, cost[:1])
        case KineticEnergyTerm(inertia=inertia):
            task = mink.KineticEnergyRegularizationTask(share * inertia)
            task.set_dt(1.0)  # the others' residuals are in Δq, and so its own
            return task
    return None


def ignored_tasks(problem: Problem) -> list[Term]:
    """Return the tasks that mink has no place for."""
    return [
        term
        for term in problem.terms
        if not isinstance(term, FreezeTerm) and task_of(term, problem) is None
    ]


def unread(problem: Problem) -> list[str]:
    """Return what else a problem asks for that mink has no place for."""
    config = problem.config
    moving = [path.path for path in config.targets.values() if path.path not in ("hold", "pose")]
    asked = {
        "a metric": bool(np.any(problem.metric)) or config.metric == "inertia",
        "an adapted damping": config.damping.adapt != "off",
        "strict levels": problem.strict,
        "a feed-forward of what moves": bool(moving or config.obstacles),
    }
    return [name for name, is_asked in asked.items() if is_asked]


def _set(task: BaseTask, target: Array, gain: float) -> None:
    """Give a task its target, and its gain as the share of the error that a step takes off."""
    if isinstance(task, mink.Task):
        task.gain = gain
    match task:
        case mink.FrameTask() | mink.RelativeFrameTask():
            task.set_target(mink.SE3(target))
        case mink.ComTask() | mink.PostureTask() | mink.LookAtTask() | mink.AxisAlignTask():
            task.set_target(target)


def _limits(problem: Problem) -> list[mink.Limit]:
    """Return mink's limits of positions, velocities and distances, and those that were added."""
    model, config = problem.model, problem.config.limits
    limits: list[mink.Limit] = []
    if config.position != "off":
        ranged, ranges = copy.copy(model), held_ranges(model, config)
        ranged.jnt_limited[:] = np.isfinite(ranges).all(axis=1)
        ranged.jnt_range[:] = np.where(ranged.jnt_limited[:, None], ranges, 0.0)
        limits.append(mink.ConfigurationLimit(ranged, config.position.gain, config.position.margin))
    speed = np.full(model.nv, np.inf)
    speed[problem.dofs] = problem.box.velocity
    joints: dict[Any, Array] = {}
    for joint in range(model.njnt):
        most = speed[joint_dofs(model, joint)]
        if joint_type(model, joint) != mujoco.mjtJoint.mjJNT_FREE:
            if np.isfinite(most).all():
                joints[joint] = most
        elif np.isfinite(most).any():
            linear, angular = (None if np.isinf(m).any() else m for m in (most[:3], most[3:]))
            name = model.joint(joint).name or None
            limits.append(mink.FreeJointVelocityLimit(model, linear, angular, name))
    limits.append(mink.VelocityLimit(model, joints))
    for barrier in problem.barriers:
        if isinstance(barrier, CollisionPairs):
            pairs = [((first,), (second,)) for first, second in barrier.geoms.tolist()]
            limits.append(
                mink.CollisionAvoidanceLimit(
                    model, pairs, barrier.gain, barrier.d_min, barrier.detect
                )
            )
    return [*limits, *problem.mink_limits]
