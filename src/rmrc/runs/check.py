"""What a configuration amounts to, and what will bind, before anything runs."""

import math
from time import thread_time

import mujoco
import numpy as np

from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.engine.closed_form import shortcomings
from rmrc.limits.box import RANGE_ROUNDING
from rmrc.limits.joints import joint_name
from rmrc.model.configuration import joint_dofs
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.runs.execution import build_execution
from rmrc.runs.follow import joint_timing
from rmrc.runs.target_paths import build_aims, build_obstacles, unfinished
from rmrc.tasks.base import square_root

SHOWN = 6
"""Distances or tasks that a line names."""
SHARE = 0.25
"""Share of the deadline up to which nothing is said of the time that rows take."""
MANY = 500
"""Dofs above which no engine is built to look at."""
OFF = 0.1
"""How far from its target a task is for what its curvature adds, m or rad."""
LOOKS, AWAY = 9, 1e-3
"""How often rows are timed, and how far from the start the joints are, rad or m: at the same place
what was measured before would be used again."""


def check(config: Config) -> list[str]:
    """Compile a configuration and build its paths; return what there is to say, a line each.

    Raises:
        ConfigError: If anything does not fit the scene.
    """
    problem = compile(config)
    aims = build_aims(problem)
    build_obstacles(problem)
    if config.follow == "joint":
        joint_timing(problem, aims)
    tasks = ", ".join(
        f"{term.name} ({term.type}, {'hard' if term.hard else f'level {term.level}'})"
        for term in problem.terms
    )
    lines = [f"{problem.dofs.size} of {problem.model.nv} dofs move; tasks: {tasks}"]
    if problem.dofs.size > MANY:
        return [*lines, _many(problem.dofs.size), *unfinished(aims, config), *problem.notices]
    controller = Controller(problem)  # what cannot run on this problem at all says so
    lines += controller.notices
    lines += shortcomings(problem)
    lines += build_execution(problem).notices
    lines += [*_at_limits(problem), *_too_near(problem), *_slow_rows(problem, controller)]
    evaluation = controller.engine.evaluation
    evaluation.update(problem.start)
    evaluation.evaluate()
    return [
        *lines,
        *_curvature(problem, controller),
        *_slow_levels(problem, controller),
        *unfinished(aims, config),
        *problem.notices,
    ]


def _many(dofs: int) -> str:
    """Return what a step of very many dofs will take, without building its engine: that takes
    minutes.
    """
    matrix = np.eye(dofs) + 1.0 / dofs
    begin = thread_time()
    np.linalg.cholesky(matrix)
    least = thread_time() - begin
    return (
        f"{dofs} dofs are very many: a step solves a dense program of that size, which takes "
        f"{least:.2g} s or more on this machine, and a run minutes to begin; name the joints that "
        "may move in `dofs`"
    )


def _at_limits(problem: Problem) -> list[str]:
    """Return the joints that are at a limit, or outside it, already at the start."""
    box, model = problem.box, problem.model
    at = problem.start[box.coordinate]
    room = np.minimum(at - box.lower, box.upper - at)
    names = {
        int(dof): model.joint(joint).name
        for joint in range(model.njnt)
        for dof in joint_dofs(model, joint)
    }
    outside = [names[int(d)] for d in problem.dofs[room < -RANGE_ROUNDING]]
    touching = [names[int(d)] for d in problem.dofs[np.abs(room) <= RANGE_ROUNDING]]
    lines = []
    if outside:
        lines.append(f"outside the position limits at the start: {', '.join(outside)}")
    if touching:
        lines.append(f"on a position limit at the start: {', '.join(touching)}")
    return lines


def _slow_rows(problem: Problem, controller: Controller) -> list[str]:
    """Return what rows take at the start, where that is a good part of the deadline.

    The clock is not looked at while they are evaluated.
    """
    if not problem.barriers or problem.deadline == math.inf:
        return []
    model, still, took = problem.model, np.zeros(problem.model.nv), []
    for k in range(LOOKS):
        q, way = problem.start.copy(), np.zeros(model.nv)
        way[problem.dofs] = AWAY * (-1.0) ** k
        mujoco.mj_integratePos(model, q, way, 1.0)
        begin = thread_time()
        controller.engine.prepare(q, still, problem.dt)
        took.append(thread_time() - begin)
    rows = float(np.median(took))
    if rows <= SHARE * problem.deadline:
        return []
    line = (
        f"a step evaluates its rows in {1e3 * rows:.2g} ms at the start, on this machine, "
        f"of a deadline of {1e3 * problem.deadline:.2g} ms"
    )
    return [f"{line}: steps end with a brake" if rows > problem.deadline else line]


def _curvature(problem: Problem, controller: Controller) -> list[str]:
    """Return what the curvature of the tasks adds to λ² at the start, a tenth off their targets.

    They have been evaluated there.
    """
    assembly, evaluation = controller.engine.assembly, controller.engine.evaluation
    lines, model = [], problem.model
    for term in assembly.curvature.ways:
        added = np.zeros(problem.dofs.size)
        for row in range(*evaluation.rows_of([term]).indices(evaluation.error.size)):
            rate = np.zeros_like(evaluation.error)
            rate[row] = OFF * min(term.gain, 1.0 / problem.dt)
            assembly.curvature.update(rate, problem.dt)
            found = sum(assembly.curvature.levels.values(), np.zeros_like(added))
            added = np.maximum(added, found)
        k = int(added.argmax())
        if added[k] > 0.0:
            joint = joint_name(model, int(model.dof_jntid[problem.dofs[k]]))
            lines.append(f"up to {added[k] / assembly.unit:.2g} at {joint} for {term.name}")
    if not lines:
        return []
    more = f"; and for {len(lines) - SHOWN} more" if len(lines) > SHOWN else ""
    return [
        f"the curvature of a task that is {OFF:g} m or rad off adds to λ² = "
        f"{problem.damping**2:.2g}: {'; '.join(lines[:SHOWN])}{more}"
    ]


def _slow_levels(problem: Problem, controller: Controller) -> list[str]:
    """Return which lower levels λ² slows down by more than half, at the start, where they have
    been evaluated.

    Where the levels above leave a task free its error decays at K s/(s + λ²), with s an eigenvalue
    of JᵀBJ; of the joints' own, s = B.
    """
    square = problem.damping**2
    if problem.config.method != "qp":
        return []
    evaluation, lines = controller.engine.evaluation, []
    for term in evaluation.terms:
        if term.hard or term.preserve or not term.level or not term.gain:
            continue
        root = square_root(term.weight * problem.soft_ratio**term.level)
        rows = np.diag(root) if root.ndim == 1 else root
        if not term.joint:
            rows = rows @ evaluation.jacobian[evaluation.rows_of([term])]
        weight = float(np.linalg.norm(rows[:, problem.dofs], 2)) ** 2
        if 0.0 < weight < square:
            lines.append(
                f"{term.name} decays at {100 * weight / (weight + square):.2g} % of its gain or "
                f"less: on level {term.level} it weighs {weight:.2g}, and λ² is {square:.2g}; "
                "for more raise its B, or lower λ"
            )
    return lines


def _too_near(problem: Problem) -> list[str]:
    """Return the distances that are below their limits already at the start."""
    model = problem.model
    data, still = mujoco.MjData(model), np.zeros((model.nmocap, 6))
    data.qpos = problem.start
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    lines = []
    for limit in problem.barriers:
        barrier = limit.build(model, still)
        near = barrier.near(data, np.zeros(model.nv), problem.dt)
        passed = near.ids[near.distance < -problem.resolution].tolist()
        if passed:
            shown = ", ".join(barrier.name(k) for k in passed[:SHOWN])
            more = f" and {len(passed) - SHOWN} more" if len(passed) > SHOWN else ""
            lines.append(f"beyond the {barrier.kind} limit at the start: {shown}{more}")
    return lines
