"""Config and MjModel to `Problem`: every name is resolved here, once."""

from collections.abc import Callable, Iterable
from typing import TypeVar

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.config.limits import LimitsModel, PerJoint
from rmrc.config.mistakes import Mistake, config_error
from rmrc.config.models import Config
from rmrc.errors import ModelError, SolverError
from rmrc.problem.configuration import (
    dof_of_joint,
    free_dofs,
    joint_dofs,
    joint_type,
    normalized,
    resolve_configuration,
)
from rmrc.problem.frames import names
from rmrc.problem.limits.box import Box
from rmrc.problem.problem import Problem
from rmrc.problem.scene import load_model
from rmrc.problem.tasks.base import FieldError, Term, weight_array
from rmrc.problem.tasks.freeze import FreezeTerm
from rmrc.problem.tasks.kinetic_energy import KineticEnergyTerm
from rmrc.qp.backends import create

Array = NDArray[np.float64]
Result = TypeVar("Result")

HINGE_SPEED = np.pi
"""Cap in rad/s of a joint without a stated velocity limit."""
MOST_STEPS = 10_000_000
"""Steps of a run, whose arrays are allocated at its start."""
SLIDE_SPEED = 1.0
"""Cap in m/s of a joint without a stated velocity limit."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_BALL = mujoco.mjtJoint.mjJNT_BALL
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE


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
        self, mink_tasks: tuple[BaseTask, ...], mink_limits: tuple[mink.Limit, ...]
    ) -> Problem:
        config = self._config
        model = self._try(("scene",), lambda: load_model(config.scene, config.root))
        self._stop_on_mistakes()
        assert model is not None
        if not model.nv:
            self._mistakes.append(Mistake(("scene",), "this model has no joints: nothing can move"))
            self._stop_on_mistakes()
        if config.duration > MOST_STEPS * config.dt:
            self._mistakes.append(
                Mistake(
                    ("duration",), f"a run has at most {MOST_STEPS:,} steps of dt; make dt longer"
                )
            )
        start = self._try(("start",), lambda: start_configuration(model, config))
        self._stop_on_mistakes()
        assert start is not None
        terms = self._terms(model, start)
        dofs = self._try(("dofs",), lambda: _dofs(model, config.dofs))
        metric = self._try(("metric",), lambda: _metric(model, config))
        box, notices = self._box(model, config.limits, terms)
        solver = config.solver
        self._try(
            ("solver", "backend"),
            lambda: create(solver.backend, max_iter=solver.max_iter, tolerance=solver.tolerance),
        )
        for task in mink_tasks:
            self._try((), lambda task=task: _evaluated(task, model, start))
        configuration = mink.Configuration(model, start)
        for limit in mink_limits:
            self._try((), lambda limit=limit: limit.compute_qp_inequalities(configuration, 1.0))
        if mink_limits and (config.priority == "strict" or any(t.preserve for t in terms)):
            self._mistakes.append(
                Mistake(("priority",), "limits of mink's are rows, which strict levels do not take")
            )
        self._stop_on_mistakes()
        assert dofs is not None
        assert metric is not None
        inertia = float(config.metric == "inertia") + sum(
            term.inertia * config.soft_ratio**term.level
            for term in terms
            if isinstance(term, KineticEnergyTerm)
        )
        if not config.damping.lambda_ and not metric.any() and not inertia:
            notices.append("λ is 0 and there is no metric: near a singularity rates are unbounded")
        if "damping" not in config.model_fields_set:
            notices.append(f"the damping is the default, λ = {config.damping.lambda_:g}")
        for equality in range(model.neq):
            name = model.equality(equality).name or f"equality {equality}"
            notices.append(f"the model's equality constraint '{name}' is not held")
        strict = config.priority == "strict"
        return Problem(
            config=config,
            model=model,
            start=start,
            dt=config.dt,
            dofs=dofs,
            terms=terms,
            metric=metric,
            inertia=inertia,
            damping=config.damping.lambda_,
            soft_ratio=1.0 if strict or config.method == "nullspace" else config.soft_ratio,
            strict=strict,
            box=_select(box, dofs),
            notices=tuple(notices),
            mink_tasks=mink_tasks,
            mink_limits=mink_limits,
        )

    def _terms(self, model: mujoco.MjModel, start: Array) -> tuple[Term, ...]:
        made = []
        for index, task in enumerate(self._config.tasks):
            made.append(self._try(("tasks", index), lambda task=task: task.compile(model, start)))
        return tuple(term for term in made if term is not None)

    def _box(
        self, model: mujoco.MjModel, limits: LimitsModel, terms: tuple[Term, ...]
    ) -> tuple[Box, list[str]]:
        notices: list[str] = []
        lower, upper = self._ranges(model, limits, notices)
        speed = self._per_joint(model, "velocity", limits.velocity)
        defaulted = _unstated(model, speed) if limits.velocity != "off" else []
        for joint in defaulted:
            slide = joint_type(model, joint) == _SLIDE
            speed[joint_dofs(model, joint)] = SLIDE_SPEED if slide else HINGE_SPEED
        if defaulted:
            notices.append(
                f"joints without a stated velocity limit are capped at π rad/s and 1 m/s: "
                f"{_listed(model, defaulted)}"
            )
        if limits.velocity == "off":
            notices.append("velocity limits are off")
        if free_dofs(model).size:
            notices.append("the floating base has no speed limit")
        for term in terms:
            if isinstance(term, FreezeTerm):
                speed[term.dofs] = 0.0
        box = Box(
            coordinate=_coordinates(model),
            lower=lower,
            upper=upper,
            gain=1.0 if limits.position == "off" else limits.position.gain,
            velocity=speed,
            acceleration=self._per_joint(model, "acceleration", limits.acceleration),
        )
        return box, notices

    def _ranges(
        self, model: mujoco.MjModel, limits: LimitsModel, notices: list[str]
    ) -> tuple[Array, Array]:
        lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        if limits.position == "off":
            notices.append("position limits are off")
            return lower, upper
        margin = limits.position.margin
        unlimited = []
        for joint in range(model.njnt):
            kind = joint_type(model, joint)
            if kind == _BALL and model.jnt_limited[joint]:
                notices.append(f"the range of ball joint '{model.joint(joint).name}' is not held")
            if kind in (_FREE, _BALL):
                continue
            if not model.jnt_limited[joint]:
                unlimited.append(joint)
                continue
            low, high = model.jnt_range[joint]
            if high - low < 2 * margin:
                name = model.joint(joint).name
                self._mistakes.append(
                    Mistake(
                        ("limits", "position", "margin"),
                        f"joint '{name}' has a range of {high - low:.3g}, too short for a margin "
                        f"of {margin:g} at each end",
                    )
                )
            dof = model.jnt_dofadr[joint]
            lower[dof], upper[dof] = low + margin, high - margin
        if "position" not in limits.model_fields_set:
            notices.append("position limits are on by default, from the model's ranges")
        if unlimited:
            notices.append(f"the model gives no range for: {_listed(model, unlimited)}")
        return lower, upper

    def _per_joint(self, model: mujoco.MjModel, key: str, limit: PerJoint | str) -> Array:
        """Return a limit as (nv,), infinite where none is stated."""
        values = np.full(model.nv, np.inf)
        if isinstance(limit, str):
            return values
        if limit.default is not None:
            values[:] = limit.default
            values[free_dofs(model)] = np.inf
        for name, value in limit.named.items():
            dofs = self._try(("limits", key, name), lambda name=name: dof_of_joint(model, name))
            if dofs is None:
                continue
            if np.isin(dofs, free_dofs(model)).any():
                self._mistakes.append(
                    Mistake(("limits", key, name), f"'{name}' is a floating base, not a joint")
                )
            values[dofs] = value
        return values


def _evaluated(task: BaseTask, model: mujoco.MjModel, start: Array) -> None:
    """Evaluate a task of mink's once, so that what it lacks is said here and not in the loop."""
    configuration = mink.Configuration(model, start)
    mujoco.mj_tendon(model, configuration.data)
    configuration.update(start)
    try:
        task.compute_qp_objective(configuration)
    except Exception as failure:  # mink's own errors, and those of a user's task
        raise ValueError(f"mink's {type(task).__name__} cannot be evaluated: {failure}") from None


def start_configuration(model: mujoco.MjModel, config: Config) -> Array:
    """Return the configuration (nq,) that a run starts from.

    Raises:
        ModelError: If the model has no such keyframe or joint.
        ValueError: If a list has the wrong length.
    """
    home = "home" if "home" in names(model, "keyframe") else None
    base = resolve_configuration(model, home, model.qpos0)
    return normalized(model, resolve_configuration(model, config.start, base))


def _dofs(model: mujoco.MjModel, joints: tuple[str, ...] | None) -> NDArray[np.intp]:
    if joints is None:
        return np.arange(model.nv)
    return np.unique(np.concatenate([dof_of_joint(model, joint) for joint in joints]))


def _metric(model: mujoco.MjModel, config: Config) -> Array:
    if config.metric == "inertia":
        return np.zeros((model.nv, model.nv))
    metric = np.asarray(config.metric, dtype=float)
    if metric.ndim and metric.shape[0] != model.nv:
        raise ValueError(f"this model has {model.nv} dofs, and the metric {metric.shape[0]}")
    full = weight_array(config.metric, model.nv)
    return np.diag(full) if full.ndim == 1 else full


def _coordinates(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the address in qpos of each dof that is a hinge or a slide, 0 for the others."""
    addresses = np.zeros(model.nv, dtype=np.intp)
    for joint in range(model.njnt):
        if joint_type(model, joint) not in (_FREE, _BALL):
            addresses[model.jnt_dofadr[joint]] = model.jnt_qposadr[joint]
    return addresses


def _unstated(model: mujoco.MjModel, speed: Array) -> list[int]:
    """Return the joints, floating bases left out, that have no velocity limit."""
    return [
        joint
        for joint in range(model.njnt)
        if joint_type(model, joint) != _FREE and np.isinf(speed[model.jnt_dofadr[joint]])
    ]


def _listed(model: mujoco.MjModel, joints: list[int], limit: int = 6) -> str:
    shown = ", ".join(model.joint(joint).name or f"joint {joint}" for joint in joints[:limit])
    return shown + (f" and {len(joints) - limit} more" if len(joints) > limit else "")


def _select(box: Box, dofs: NDArray[np.intp]) -> Box:
    return Box(
        coordinate=box.coordinate[dofs],
        lower=box.lower[dofs],
        upper=box.upper[dofs],
        gain=box.gain,
        velocity=box.velocity[dofs],
        acceleration=box.acceleration[dofs],
    )
