"""Config and MjModel to `Problem`: every name is resolved here, once."""

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TypeVar

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.config.compiled_scene import scene_of
from rmrc.config.models import Config
from rmrc.config.solvers import require
from rmrc.errors import ModelError, SolverError
from rmrc.limits.joints import compile_box, per_joint, select
from rmrc.limits.rows import compile_barriers, compile_speeds
from rmrc.model.configuration import (
    dof_of_joint,
    turning_dofs,
)
from rmrc.model.extents import resolution, size
from rmrc.model.objects import (
    Objects,
    bodies_of_equality,
    bodies_of_joints,
    claimed_by_mink,
    find_objects,
)
from rmrc.model.scene import Scene
from rmrc.problem.problem import Problem
from rmrc.problem.start import place_mocap_bodies, start_configuration
from rmrc.tasks.base import BendingTerm, FieldError, Term, weight_array
from rmrc.tasks.freeze import FreezeTerm
from rmrc.tasks.kinetic_energy import KineticEnergyTerm
from rmrc.tasks.loop import LoopTask, LoopTerm, equality_name, held_by_default
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]
Result = TypeVar("Result")

MOST_STEPS = 10_000_000
"""Steps of a run, whose arrays are allocated at its start."""
EQUALITIES = "equalities"
"""The name of the term that holds the model's own equalities."""
MOST_EQUALITIES = 6
"""Equalities that a notice names."""
LONGEST_STEP = 10.0
"""Most that a joint moves in a step beside distances that are kept, rad or m, and in lengths of a
robot that is longer than 1 m: what a longer one could come to is not looked at."""


def compile(
    config: Config,
    mink_tasks: Iterable[BaseTask] = (),
    mink_limits: Iterable[mink.Limit] = (),
) -> Problem:
    """Resolve a configuration against its scene.

    Args:
        config: The configuration.
        mink_tasks: Tasks of mink's to add, with mink's meaning of cost, gain and damping.
        mink_limits: Limits of mink's to add, as rows.

    Raises:
        ConfigError: If anything does not fit the model; the message lists every mistake.
    """
    return _Compiler(config).problem(tuple(mink_tasks), tuple(mink_limits))


def recompile(problem: Problem, config: Config) -> Problem:
    """Resolve a changed configuration on the model of a problem and from its start.

    What says of the scene and of the start differs is not looked at.

    Raises:
        ConfigError: If anything does not fit the model; the message lists every mistake.
    """
    return _Compiler(config).problem(problem.mink_tasks, problem.mink_limits, problem)


class _Compiler:
    """Collects the mistakes on the way, so that all are reported at once."""

    def __init__(self, config: Config):
        self._config = config
        self._mistakes: list[Mistake] = []

    def _try(self, location: tuple[str | int, ...], make: Callable[[], Result]) -> Result | None:
        try:
            return make()
        except FieldError as mistake:
            self._mistakes.append(Mistake((*location, mistake.key), str(mistake)))
        except (ModelError, SolverError, ValueError) as mistake:
            self._mistakes.append(Mistake(location, str(mistake)))
        return None

    def _stop_on_mistakes(self) -> None:
        if self._mistakes:
            raise config_error(self._mistakes, self._config)

    def problem(
        self,
        mink_tasks: tuple[BaseTask, ...],
        mink_limits: tuple[mink.Limit, ...],
        before: Problem | None = None,
    ) -> Problem:
        config, mistakes = self._config, self._mistakes
        scene, start, begins = self._scene_at_start() if before is None else before.begun
        model = scene.model
        objects = self._objects(model, mink_tasks)
        terms = self._terms(model, start, objects)
        terms += self._held_by_default(model, start, objects, terms)
        dofs = self._try(("dofs",), lambda: _dofs(objects, config.dofs))
        metric = self._try(("metric",), lambda: _metric(model, config))
        box, notices = compile_box(objects, config.limits, mistakes, scene.velocity)
        for frozen in (term.dofs for term in terms if isinstance(term, FreezeTerm)):
            box.velocity[frozen] = 0.0
        terms = tuple(term.within(box.lower, box.upper) for term in terms)
        moving = np.flatnonzero(~objects.dofs) if dofs is None else dofs
        notices += self._unmoved(model, terms, set(moving.tolist()))
        barriers = compile_barriers(objects, config.limits, start, moving, mistakes, notices)
        if barriers:
            box.step[:] = np.where(turning_dofs(model), 1.0, max(1.0, size(model))) * LONGEST_STEP
        speeds = compile_speeds(config.limits, terms, mistakes)
        lag = per_joint(objects, ("lag",), config.lag, 0.0, mistakes)
        self._try_solver()
        self._try_mink(mink_tasks, mink_limits, model, start)
        self._stop_on_mistakes()
        assert dofs is not None
        assert metric is not None
        inertia = _share_of_inertia(config, terms)
        strict, solver, timeout = config.priority == "strict", config.solver, config.timeout
        return Problem(
            config=config,
            begun=(scene, start, begins),
            model=model,
            start=start,
            dt=config.dt,
            dofs=dofs,
            objects=objects,
            terms=terms,
            metric=metric,
            inertia=inertia,
            damping=config.damping.lambda_,
            curvature=config.damping.curvature,
            soft_ratio=1.0 if strict or config.method == "nullspace" else config.soft_ratio,
            strict=strict,
            box=select(box, dofs),
            lag=lag,
            notices=(
                *begins,
                *scene.notices,
                *objects.notices(),
                *notices,
                *_damping_notices(config, bool(metric.any() or inertia)),
                *_equality_notices(model, terms),
            ),
            barriers=barriers,
            resolution=resolution(model),
            speeds=speeds,
            deadline=1e-6 * (solver.deadline or math.inf),
            target_timeout=timeout.target or math.inf,
            measurement_timeout=timeout.measurement or math.inf,
            mink_tasks=mink_tasks,
            mink_limits=mink_limits,
        )

    def _unmoved(
        self, model: mujoco.MjModel, terms: tuple[Term, ...], moving: set[int]
    ) -> list[str]:
        """Note the tasks whose frame no joint moves, which could never do anything; return what to
        say of those that none of `dofs` does.
        """
        notices: list[str] = []
        index = {task.name: k for k, task in enumerate(self._config.tasks)}
        for term in terms:
            if not isinstance(term, BendingTerm) or moving.intersection(term.way(model).dofs):
                continue
            if term.way(model).dofs:
                notices.append(f"none of `dofs` moves {term.name}: it only says how far it is off")
                continue
            key = (
                "frame"
                if "frame" in type(self._config.tasks[index[term.name]]).model_fields
                else None
            )
            place = ("tasks", index[term.name], *([key] if key else []))
            message = "no joint moves this: name a frame that hangs on a joint that may move"
            self._mistakes.append(Mistake(place, message))
        return notices

    def _scene_at_start(self) -> tuple[Scene, Array, list[str]]:
        """Return the scene, the start configuration, without which nothing else is tried, and
        what to say of it.
        """
        config = self._config
        scene = self._try(("scene",), lambda: scene_of(config))
        self._stop_on_mistakes()
        assert scene is not None
        model = scene.model
        if not model.nv:
            self._mistakes.append(Mistake(("scene",), "this model has no joints: nothing can move"))
            self._stop_on_mistakes()
        if config.duration > MOST_STEPS * config.dt:
            self._mistakes.append(
                Mistake(
                    ("duration",), f"a run has at most {MOST_STEPS:,} steps of dt; make dt longer"
                )
            )
        start = self._try(
            ("start",), lambda: start_configuration(scene, config.start, config.limits)
        )
        self._stop_on_mistakes()
        assert start is not None
        # Distances of smooth geoms are measured no more finely than this.
        model.opt.ccd_tolerance = min(model.opt.ccd_tolerance, resolution(model))
        self._try(("start",), lambda: place_mocap_bodies(model, config.start))
        self._stop_on_mistakes()
        return scene, *start

    def _objects(self, model: mujoco.MjModel, mink_tasks: tuple[BaseTask, ...]) -> Objects:
        """Return what is not the robot; a name that is unknown is a mistake of its task's."""
        claimed = claimed_by_mink(model, mink_tasks)
        for claim in (
            lambda: bodies_of_joints(model, self._config.dofs or ()),
            *(lambda task=task: task.claimed(model) for task in self._config.tasks),
        ):
            with suppress(ModelError, ValueError):
                claimed += claim()
        held = () if self._config.equalities == "off" else held_by_default(model)
        return find_objects(model, claimed, [bodies_of_equality(model, i) for i in held])

    def _held_by_default(
        self, model: mujoco.MjModel, start: Array, objects: Objects, terms: tuple[Term, ...]
    ) -> tuple[Term, ...]:
        """Return the term of the equalities that no task names, if there are any."""
        if self._config.equalities == "off":
            return ()
        named = {i for term in terms if isinstance(term, LoopTerm) for i in term.equalities}
        held = [
            i
            for i in held_by_default(model)
            if i not in named and not objects.bodies[bodies_of_equality(model, i)].any()
        ]
        if not held:
            return ()
        taken, name = {term.name for term in terms}, EQUALITIES
        while name in taken:
            name += "_"
        return (LoopTask(name=name).term(model, start, tuple(held)),)

    def _try_solver(self) -> None:
        solver = self._config.solver
        self._try(
            ("solver", "backend"),
            lambda: require(solver.backend, solver.max_iter, solver.tolerance),
        )

    def _try_mink(
        self,
        tasks: tuple[BaseTask, ...],
        limits: tuple[mink.Limit, ...],
        model: mujoco.MjModel,
        start: Array,
    ) -> None:
        """Evaluate what is mink's once."""
        for task in tasks:
            self._try((), lambda task=task: _evaluated(task, model, start))
        configuration = mink.Configuration(model, start)
        for limit in limits:
            self._try((), lambda limit=limit: limit.compute_qp_inequalities(configuration, 1.0))

    def _terms(self, model: mujoco.MjModel, start: Array, objects: Objects) -> tuple[Term, ...]:
        made = []
        for index, task in enumerate(self._config.tasks):
            made.append(
                self._try(
                    ("tasks", index),
                    lambda task=task: task.compile(model, start).without(objects, start),
                )
            )
        return tuple(term for term in made if term is not None)


def _share_of_inertia(config: Config, terms: tuple[Term, ...]) -> float:
    """Return the share of M(q) in A."""
    return float(config.metric == "inertia") + sum(
        term.inertia * config.soft_ratio**term.level
        for term in terms
        if isinstance(term, KineticEnergyTerm)
    )


def _damping_notices(config: Config, metric: bool) -> list[str]:
    """Return what there is to say about the damping, with or without a metric."""
    damping, notices = config.damping, []
    if not damping.lambda_ and damping.adapt == "off" and not metric:
        notices.append("λ is 0 and there is no metric: near a singularity rates are unbounded")
    if "damping" not in config.model_fields_set:
        notices.append(f"the damping is the default, λ = {damping.lambda_:g}")
    return notices


def _equality_notices(model: mujoco.MjModel, terms: tuple[Term, ...]) -> list[str]:
    """Return which of the model's own equalities are held, and which are not."""
    held = {i for term in terms if isinstance(term, LoopTerm) for i in term.equalities}
    active = np.flatnonzero(model.eq_active0).tolist()
    lines = []
    for ids, verdict in (
        ([i for i in active if i in held], "held"),
        ([i for i in active if i not in held], "not held"),
    ):
        if ids:
            shown = ", ".join(f"'{equality_name(model, i)}'" for i in ids[:MOST_EQUALITIES])
            more = f" and {len(ids) - MOST_EQUALITIES} more" if len(ids) > MOST_EQUALITIES else ""
            lines.append(f"equality constraints of the model that are {verdict}: {shown}{more}")
    return lines


def _evaluated(task: BaseTask, model: mujoco.MjModel, start: Array) -> None:
    """Evaluate a task of mink's once, so that what it lacks is said here and not in the loop."""
    configuration = mink.Configuration(model, start)
    mujoco.mj_tendon(model, configuration.data)
    configuration.update(start)
    try:
        task.compute_qp_objective(configuration)
    except Exception as failure:  # mink's own errors, and those of a user's task
        raise ValueError(f"mink's {type(task).__name__} cannot be evaluated: {failure}") from None


def _dofs(objects: Objects, joints: tuple[str, ...] | None) -> NDArray[np.intp]:
    if joints is None:
        return np.flatnonzero(~objects.dofs)
    return np.unique(np.concatenate([dof_of_joint(objects.model, joint) for joint in joints]))


def _metric(model: mujoco.MjModel, config: Config) -> Array:
    if config.metric == "inertia":
        return np.zeros((model.nv, model.nv))
    metric = np.asarray(config.metric, dtype=float)
    if metric.ndim and metric.shape[0] != model.nv:
        raise ValueError(f"this model has {model.nv} dofs, and the metric {metric.shape[0]}")
    full = weight_array(config.metric, model.nv)
    return np.diag(full) if full.ndim == 1 else full
