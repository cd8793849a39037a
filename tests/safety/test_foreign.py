"""Code of others that a step calls: whatever it answers, v is finite and inside its box."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from mink.limits import Constraint
from mink.tasks import BaseTask, Objective

import rmrc
from braking import left_of
from models import config
from rmrc.control.status import Status

A_MAX = 20.0
V_MAX = 2.0
# Of a rate, rad/s.
ROUNDING = 1e-12
DT = 0.002
HAND = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
TARGET = {"position": [0.5, 0.2, 0.4]}
ENGINES = ("python", "native")


class Task(BaseTask):
    """Answers 0 until it is given something else to answer."""

    answer: Callable[[int], Any] | None = None
    residual = False

    def compute_qp_residual(self, configuration: mink.Configuration) -> Any:
        if self.answer is None or not self.residual:
            return None
        return self.answer(configuration.model.nv)

    def compute_qp_objective(self, configuration: mink.Configuration) -> Objective:
        nv = configuration.model.nv
        if self.answer is None:
            return Objective(np.zeros((nv, nv)), np.zeros(nv))
        return self.answer(nv)


class Limit(mink.Limit):
    """Limits nothing until it is given something to answer."""

    answer: Callable[[int], Any] | None = None

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        return Constraint() if self.answer is None else self.answer(configuration.model.nv)


def raises(nv: int) -> Any:
    raise RuntimeError("out of order")


OBJECTIVES = {
    "NaN in H": lambda nv: Objective(np.full((nv, nv), np.nan), np.zeros(nv)),
    "infinity in c": lambda nv: Objective(np.eye(nv), np.full(nv, np.inf)),
    "another shape": lambda nv: Objective(np.eye(nv + 1), np.zeros(nv)),
    "a column": lambda nv: Objective(np.eye(nv), np.zeros((nv, 1))),
    "None": lambda nv: None,
    "text": lambda nv: Objective("H", "c"),  # pyright: ignore
    "an exception": raises,
}
RESIDUALS = {
    "NaN in J": lambda nv: (np.full((3, nv), np.nan), np.zeros(3), 0.0),
    "NaN in e": lambda nv: (np.ones((3, nv)), np.full(3, np.nan), 0.0),
    "rows that do not fit": lambda nv: (np.ones((3, nv)), np.zeros(4), 0.0),
    "NaN damping": lambda nv: (np.ones((3, nv)), np.zeros(3), np.nan),
    "too few parts": lambda nv: (np.ones((3, nv)),),
}
LIMITS = {
    "NaN in G": lambda nv: Constraint(np.full((2, nv), np.nan), np.ones(2)),
    "NaN in h": lambda nv: Constraint(np.ones((2, nv)), np.full(2, np.nan)),
    "another shape": lambda nv: Constraint(np.ones((2, nv + 1)), np.ones(2)),
    "another length": lambda nv: Constraint(np.ones((2, nv)), np.ones(3)),
    "None": lambda nv: None,
    "an exception": raises,
}


def controller(repository: Path, engine: str, **foreign: Any) -> rmrc.Controller:
    scene = str(repository / "scenes" / "panda.xml")
    limits = {"velocity": {"default": V_MAX}, "acceleration": {"default": A_MAX}}
    given = config(scene, [HAND], start="home", dt=DT, limits=limits)
    return rmrc.Controller(rmrc.compile(given, **foreign), engine=engine)  # type: ignore


def step_inside(made: rmrc.Controller, before: np.ndarray) -> rmrc.Step:
    """Take a step, and hold it to the box."""
    step = made.step()
    assert np.isfinite(step.v).all()
    assert (np.abs(step.v - before) <= A_MAX * DT + ROUNDING).all()
    assert (np.abs(step.v) <= V_MAX + ROUNDING).all()
    return step


def brakes_and_recovers(made: rmrc.Controller, foreign: Task | Limit, answer: Any) -> None:
    """Have an answer come in on the way: the robot brakes, says so, and goes on afterwards."""
    made.set_target("hand", **TARGET)
    before = np.zeros(made.problem.model.nv)
    for _ in range(5):
        before = step_inside(made, before).v
    foreign.answer = answer
    for _ in range(20):
        step = step_inside(made, before)
        assert step.status is Status.INVALID_INPUT
        assert step.reasons[0].startswith(f"{type(foreign).__name__}: ")
        left = left_of(before, np.full(before.size, A_MAX * DT))
        np.testing.assert_allclose(step.v, left, rtol=0.0, atol=ROUNDING)
        before = step.v
    assert not before.any()
    foreign.answer = None
    step = step_inside(made, before)
    assert step.status is not Status.INVALID_INPUT
    assert not step.reasons


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("answer", OBJECTIVES.values(), ids=list(OBJECTIVES))
def test_an_objective_that_is_none(repository: Path, engine: str, answer: Any) -> None:
    task = Task()
    brakes_and_recovers(controller(repository, engine, mink_tasks=[task]), task, answer)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("answer", RESIDUALS.values(), ids=list(RESIDUALS))
def test_a_residual_that_is_none(repository: Path, engine: str, answer: Any) -> None:
    task = Task()
    task.residual = True
    brakes_and_recovers(controller(repository, engine, mink_tasks=[task]), task, answer)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("answer", LIMITS.values(), ids=list(LIMITS))
def test_a_limit_that_is_none(repository: Path, engine: str, answer: Any) -> None:
    limit = Limit()
    brakes_and_recovers(controller(repository, engine, mink_limits=[limit]), limit, answer)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_answer_that_is_none_is_named_with_what_it_lacks(repository: Path, engine: str) -> None:
    task = Task()
    made = controller(repository, engine, mink_tasks=[task])
    task.answer = OBJECTIVES["None"]
    assert made.step().reasons == ("Task: its objective is None, and has no H",)


@pytest.mark.parametrize("method", ["dls", "mink"])
def test_other_methods_brake_as_well(repository: Path, method: str) -> None:
    scene, task = str(repository / "scenes" / "panda.xml"), Task()
    given = config(scene, [HAND], start="home", dt=DT, method=method)
    made = rmrc.Controller(rmrc.compile(given, mink_tasks=[task]))
    made.set_target("hand", **TARGET)
    assert made.step().v.any()
    task.answer = raises
    step = made.step()
    assert step.reasons == ("Task: out of order",)
    assert not step.v.any()


def test_a_limit_that_is_infinite_limits_nothing(repository: Path) -> None:
    limit, nv = Limit(), 7
    made = controller(repository, "native", mink_limits=[limit])
    limit.answer = lambda nv: Constraint(np.zeros((1, nv)), np.full(1, np.inf))
    made.set_target("hand", **TARGET)
    assert step_inside(made, np.zeros(nv)).status < Status.MAX_ITER


@pytest.mark.parametrize(("engine", "steps"), [("native", 2000), ("python", 30)])
def test_an_indefinite_objective(repository: Path, engine: str, steps: int) -> None:
    """H is finite and symmetric, but no program has an optimum with it as a rule."""
    rng, task = np.random.default_rng(0), Task()

    def indefinite(nv: int) -> Objective:
        root = rng.normal(size=(nv, nv))
        return Objective((root + root.T) * 10.0 ** rng.uniform(-3, 3), rng.normal(size=nv))

    made = controller(repository, engine, mink_tasks=[task])
    task.answer = indefinite
    before, found = np.zeros(made.problem.model.nv), set()
    for _ in range(steps):
        step = step_inside(made, before)
        before = step.v
        found.add(step.status)
    assert Status.MAX_ITER in found or engine == "python"
    task.answer = None
    assert step_inside(made, before).status < Status.MAX_ITER


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("spoiled", [np.nan, np.inf, RuntimeError])
def test_a_term_that_python_evaluates(repository: Path, engine: str, spoiled: Any) -> None:
    """`manipulability` is one that the native engine has evaluated in Python."""
    scene = str(repository / "scenes" / "panda.xml")
    other = {"name": "dexterity", "type": "manipulability", "frame": {"site": "hand"}}
    limits = {"velocity": {"default": V_MAX}, "acceleration": {"default": A_MAX}}
    given = config(scene, [HAND, other], start="home", dt=DT, limits=limits)
    made = rmrc.Controller(rmrc.compile(given), engine=engine)  # type: ignore
    evaluation: Any = made.engine.evaluation
    rows = evaluation.rows_of([made.problem.term["dexterity"]])

    def spoil() -> None:
        if isinstance(spoiled, float):
            evaluation.feedforward[rows] = spoiled
        else:
            raise spoiled

    kind = type(made.problem.term["dexterity"])
    evaluation.evaluators[kind] = spoil
    if engine == "native":
        made.engine._foreign = [(kind, spoil)]  # type: ignore
    made.set_target("hand", **TARGET)
    step = step_inside(made, np.zeros(made.problem.model.nv))
    assert step.status is Status.INVALID_INPUT
    assert not step.v.any()
