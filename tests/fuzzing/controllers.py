"""Random problems under hostile inputs and foreign code: each step is finite and inside its box."""

from pathlib import Path
from typing import Any, cast

import mink
import numpy as np
from mink.limits import Constraint
from mink.tasks import BaseTask, Objective

import rmrc
from fuzzing import scenes
from fuzzing.numbers import Array, Generator, among, numbers
from rmrc.control.step import Step
from rmrc.errors import RmrcError

ROUNDING = 1e-12
"""Share of a rate by which it may pass its limit."""


class Broken(Exception):
    """What foreign code raises."""


def answer(rng: Generator, *shape: int) -> Any:
    """Return what nobody asked for in place of an array, or one with whatever numbers."""
    match rng.integers(8):
        case 0:
            return None
        case 1:
            return "none"
        case 2:
            return numbers(rng, *(size + 1 for size in shape), hostile=0.0)
        case 3:
            return np.zeros(0)
        case 4:
            return np.full(shape, among(rng, np.nan, np.inf, -np.inf))
        case 5:
            raise Broken
        case _:
            return numbers(rng, *shape, hostile=0.7)


class Task(BaseTask):
    """A task of mink's that answers what it likes, once it is on."""

    def __init__(self, rng: Generator):
        self.rng, self.on = rng, False

    def compute_qp_residual(self, configuration: mink.Configuration) -> Any:
        nv = configuration.model.nv
        if not self.on or self.rng.random() < 0.5:
            return None
        if self.rng.random() < 0.2:
            return answer(self.rng, 2)
        rows = int(self.rng.integers(60))
        damping = among(self.rng, 0.0, 1e-3, -1.0, np.nan)
        return answer(self.rng, rows, nv), answer(self.rng, rows), damping

    def compute_qp_objective(self, configuration: mink.Configuration) -> Objective:
        nv = configuration.model.nv
        if not self.on:
            return Objective(np.zeros((nv, nv)), np.zeros(nv))
        if self.rng.random() < 0.2:
            return answer(self.rng, nv)
        root = answer(self.rng, nv, nv)
        if isinstance(root, np.ndarray) and root.shape == (nv, nv):
            with np.errstate(all="ignore"):
                root = root + root.T
        return Objective(root, answer(self.rng, nv))


class Limit(mink.Limit):
    """A limit of mink's that answers what it likes, once it is on."""

    def __init__(self, rng: Generator):
        self.rng, self.on = rng, False

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        if not self.on:
            return Constraint()
        if self.rng.random() < 0.1:
            return answer(self.rng, 1)
        rows = int(self.rng.integers(60))
        return Constraint(
            answer(self.rng, rows, configuration.model.nv), np.abs(answer(self.rng, rows))
        )


class Spoiled:
    """An evaluator of a term that Python evaluates, which now and then fails."""

    def __init__(self, rng: Generator, evaluate: Any, evaluation: Any):
        self._rng, self._evaluate, self._evaluation = rng, evaluate, evaluation

    def __call__(self) -> None:
        self._evaluate()
        part = among(self._rng, self._evaluation.error, self._evaluation.jacobian)
        match self._rng.integers(4):
            case 0 if part.size:
                part.flat[self._rng.integers(part.size)] = among(self._rng, np.nan, np.inf, 1e300)
            case 1:
                raise Broken
            case _:
                pass


def run(rng: Generator, folder: Path) -> int:
    """Take some steps of a random problem; return how many."""
    config = scenes.config(rng, folder)
    if config is None:
        return 0
    foreign: list[Any] = []
    if rng.random() < 0.3:
        foreign = [among(rng, Task, Limit)(rng) for _ in range(int(rng.integers(1, 3)))]
    try:
        problem = rmrc.compile(
            config,
            mink_tasks=[each for each in foreign if isinstance(each, Task)],
            mink_limits=[each for each in foreign if isinstance(each, Limit)],
        )
    except RmrcError:
        return 0
    if not foreign and rng.random() < 0.2:
        return run_batch(rng, problem)
    engine = among(rng, "auto", "auto", "auto", "python")
    controller = rmrc.Controller(problem, engine=engine)
    spoil(rng, controller)
    for each in foreign:
        each.on = True
    count = int(rng.integers(5, 30))
    for _ in range(count):
        disturb(rng, controller)
        before = cast(Any, controller)._v.copy()
        dt = among(rng, None, None, None, 1e-9, 0.5, 0.0, np.nan, np.inf, -1.0, "x", None)
        step = controller.step(configuration(rng, problem.model.nq, controller.q), dt)
        check(problem, before, step, dt)
        if rng.random() < 0.1:
            str(step.explain())
    return count


def spoil(rng: Generator, controller: rmrc.Controller) -> None:
    """Have what Python evaluates for the native engine fail now and then."""
    engine = cast(Any, controller.engine)
    if getattr(engine, "_foreign", None) and rng.random() < 0.3:
        evaluation = controller.engine.evaluation
        engine._foreign = [
            (kind, Spoiled(rng, evaluate, evaluation)) for kind, evaluate in engine._foreign
        ]


def configuration(rng: Generator, nq: int, q: Array) -> Any:
    """Return a configuration to start a step from: none, one nearby, or no configuration."""
    match rng.integers(6):
        case 0 | 1:
            return None
        case 2:
            return q
        case 3:
            return q + 0.1 * rng.normal(size=nq)
        case 4:
            return q * among(rng, 0.0, 1e3, 1e11)
        case _:
            return answer_or_none(rng, nq)


def answer_or_none(rng: Generator, *shape: int) -> Any:
    """Return what is given in place of an array."""
    try:
        return answer(rng, *shape)
    except Broken:
        return object()


def disturb(rng: Generator, controller: rmrc.Controller) -> None:
    """Set targets and obstacles, to valid poses and to what is none; or start anew."""
    problem = controller.problem
    for term in problem.terms:
        if rng.random() > 0.2:
            continue
        given: dict[str, Any] = {
            "position": among(rng, rng.normal(size=3), 1e6 * rng.normal(size=3)),
            "quaternion": rng.normal(size=4),
            "velocity": among(rng, None, rng.normal(size=6), rng.normal(size=3)),
        }
        if rng.random() < 0.3:
            given[among(rng, *given)] = answer_or_none(rng, int(among(rng, 3, 4, 6)))
        if term.target_kind != "pose":
            given["quaternion"] = None
        controller.set_target(term.name, **given)
    for k in range(problem.model.nbody):
        if problem.model.body_mocapid[k] >= 0 and rng.random() < 0.2:
            name = problem.model.body(k).name
            controller.set_obstacle(name, rng.normal(size=3), velocity=numbers(rng, 6, hostile=0.3))
    if rng.random() < 0.05:
        controller.reset()


def check(problem: rmrc.Problem, before: Array, step: Step, dt: Any) -> None:
    """Hold a step to its box: finite, inside the acceleration limits, and then the velocity's."""
    assert np.isfinite(step.v).all()
    assert np.isfinite(step.q).all()
    if problem.config.previous == "measured":
        return  # what it counts from need not be inside the limits
    box, dofs = problem.box, problem.dofs
    valid = isinstance(dt, float) and 1e-9 <= dt <= 1e3
    seconds = dt if valid else problem.dt
    v, start = step.v[dofs], before[dofs]
    change = box.acceleration * seconds
    rounding = ROUNDING * (1.0 + np.abs(v) + np.abs(start))
    assert (np.abs(v - start) <= change + rounding).all()
    assert (np.abs(v) <= np.maximum(box.velocity, np.abs(start) - change) + rounding).all()


def run_batch(rng: Generator, problem: rmrc.Problem) -> int:
    """Take steps of some elements at once."""
    n, nq = int(among(rng, 1, 2, 9, 40)), problem.model.nq
    batch = rmrc.BatchController(problem, n, threads=int(among(rng, 1, 2, 3)))
    poses = [term for term in problem.terms if term.target_kind in ("pose", "point")]
    start = np.tile(problem.start, (n, 1))
    count = int(rng.integers(3, 12))
    for _ in range(count):
        for term in poses:
            width = 7 if term.target_kind == "pose" else 3
            targets = among(rng, rng.normal(size=(n, width)), numbers(rng, n, width, hostile=1.0))
            batch.set_targets(term.name, targets)
        q = among(rng, None, start + 0.1 * rng.normal(size=(n, nq)), numbers(rng, n, nq, hostile=1))
        step = batch.step(q, among(rng, None, 1e-9, 0.5))
        assert np.isfinite(step.v).all()
        assert np.isfinite(step.q).all()
        assert (step.flags >= 0).all()
        if rng.random() < 0.1:
            batch.reset()
    # What a controller's engine remembers was the batch's memory.
    first = getattr(cast(Any, batch)._elements, "_first", None)
    del batch
    if first is not None:
        assert np.isfinite(first.step().v).all()
    return count * n
