"""Why a step is what it is: the right limit, by its name, at its price, and without a trace."""

import re
from typing import Any

import numpy as np
import pytest
from matrix import ACCELERATION, DT, LIMITS, ROBOTS, each_backend, each_robot, problem, with_backend
from numpy.typing import NDArray
from obstacles import BALL, beside_a_ball

import rmrc
from models import REPOSITORY
from rmrc import Status
from rmrc.control.explain import Binding
from rmrc.runs.check import check

Array = NDArray[np.float64]

FORWARD = (0.3, 0.0, -0.2)
"""A shift of the Panda's hand that its second joint follows upwards, m."""
RELAXED = 1e-4
"""By how much a limit is relaxed to see what the cost falls by, rad/s or m/s."""
# A second difference of the cost, and the solver's own tolerance, relative to its first.
PRICE = 0.02
# Two solutions of programs that differ by a factor, relative.
FACTOR = 1e-5


def panda(limits: dict[str, Any], *tasks: dict[str, Any], **others: Any) -> rmrc.Controller:
    """Return a controller of the Panda with no limits but these, sent forward."""
    given = {"position": {}, "velocity": "off", **limits}
    made = problem("panda", "auto", *ROBOTS["panda"].tasks(), *tasks, limits=given, **others)
    controller = rmrc.Controller(made)
    assert controller.set_target("hand", made.term["hand"].target[4:] + FORWARD)
    return controller


def cost(controller: rmrc.Controller, v: Array) -> float:
    """Return Σ ½ (J v − ẋ)ᵀ B (J v − ẋ) + ½ λ² ‖v‖² at the last step, without a unit."""
    evaluation, assembly = controller.engine.evaluation, controller.engine.assembly
    total = 0.5 * controller.problem.damping**2 * float(v @ v)
    for term in evaluation.terms:
        rows = evaluation.rows_of([term])
        got = v if term.joint else evaluation.jacobian[rows] @ v
        missed = got - assembly.rate[rows]
        total += 0.5 * float(missed @ (term.weight * missed))
    return total


def bound_by(step: rmrc.Step, kind: str, name: str) -> Binding:
    """Return what binds of a kind and a name."""
    [found] = [
        binding
        for binding in step.explain().bindings
        if binding.limit == kind and binding.name == name
    ]
    return found


HOME = (0.0, 0.0, 0.0, -0.5 * np.pi, 0.0, 0.5 * np.pi, -0.25 * np.pi)


def position(by: float) -> dict[str, Any]:
    return {"position": {"joint2": [-1.0, 0.0004 + by * DT / 0.95]}}


def velocity(by: float) -> dict[str, Any]:
    return {"velocity": {"default": 50.0, "joint2": 0.2 + by}}


def acceleration(by: float) -> dict[str, Any]:
    return {"acceleration": {"default": 1e4, "joint2": 50.0 + by / DT}}


def jerk(by: float) -> dict[str, Any]:
    return {"jerk": {"default": 1e9, "joint2": 5e4 + by / DT**2}}


def plane(by: float) -> dict[str, Any]:
    # The hand starts at a height of 0.5211 m.
    offset = 0.52 - by * DT / 0.9
    frame = {"frame": {"site": "hand"}, "normal": [0.0, 0.0, 1.0], "offset": offset}
    return {"workspace": [frame]}


def pair(by: float) -> dict[str, Any]:
    # The palm starts at a height of 0.5585 m.
    d_min = 0.554 - by * DT / 0.9
    between = {"pairs": [["palm", "floor"]], "d_min": d_min, "detect": 1.0, "gain": 0.9}
    return {"collision": between}


PRICED = {
    "position": (position, "joint2"),
    "velocity": (velocity, "joint2"),
    "acceleration": (acceleration, "joint2"),
    "jerk": (jerk, "joint2"),
    "workspace": (plane, "site 'hand' and plane 1"),
    "collision": (pair, "floor – palm"),
}


@pytest.mark.parametrize("kind", PRICED)
def test_a_multiplier_is_what_the_cost_falls_by(kind: str) -> None:
    limit, name = PRICED[kind]
    bare = {"damping": {"curvature": "off"}}  # `cost` has no X
    tight, loose = panda(limit(0.0), **bare), panda(limit(RELAXED), **bare)
    step = tight.step()
    found = bound_by(step, kind, name)
    eased = loose.step()
    fallen = cost(tight, step.v) - cost(tight, eased.v)
    assert fallen > 0.0
    assert found.multiplier == pytest.approx(fallen / RELAXED, rel=PRICE)
    assert step.explain().relief == found
    assert f"relaxing the {kind} limit of {name}" in str(step.explain())


@pytest.mark.parametrize("kind", PRICED)
def test_multipliers_are_in_the_weights_own_unit(kind: str) -> None:
    limit, name = PRICED[kind]
    factor, once = 250.0, panda(limit(0.0))
    tasks = [
        {**task, "B": factor * (0.01 if task["type"] == "posture" else 1.0)}
        for task in ROBOTS["panda"].tasks()
    ]
    limits = {"position": {}, "velocity": "off", **limit(0.0)}
    damping = {"lambda": float(once.problem.damping * np.sqrt(factor))}
    heavy = rmrc.Controller(problem("panda", "auto", *tasks, limits=limits, damping=damping))
    heavy.set_target("hand", heavy.problem.term["hand"].target[4:] + FORWARD)
    first, second = once.step(), heavy.step()
    np.testing.assert_allclose(second.v, first.v, rtol=0.0, atol=FACTOR)
    light, weighty = (bound_by(step, kind, name).multiplier for step in (first, second))
    assert weighty == pytest.approx(factor * light, rel=FACTOR)


def test_a_joint_that_brakes_for_its_range_is_held_by_its_position() -> None:
    controller = panda(
        {"acceleration": {"default": 15.0}, "position": {"joint2": [-1.0, 0.01]}},
        {"name": "quick", "type": "posture", "B": 1.0, "gain": 100.0},
        damping={"curvature": "off"},  # with it the task itself asks for less
    )
    controller.reset(v=[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    q = np.array(HOME)
    q[1] = 0.02
    controller.set_target("quick", q=q)
    step = controller.step()
    found = bound_by(step, "position", "joint2")
    assert found.side == "upper"
    assert found.bound == pytest.approx(-15.0 * DT + np.sqrt((15.0 * DT) ** 2 + 0.3), rel=1e-6)


def test_jerk_is_told_from_position_on_joints_that_have_both() -> None:
    controller = panda({"jerk": {"default": 500.0}, "velocity": {"default": 2.0}})
    kinds = {binding.limit for binding in controller.step().explain().bindings}
    assert kinds == {"jerk"}


def test_a_joint_outside_its_range_is_held_by_its_position() -> None:
    controller = panda({"position": {"joint2": [0.1, 1.0]}, "velocity": {"default": 0.5}})
    target = controller.problem.term["hand"].target[4:]
    controller.set_target("hand", target - np.array(FORWARD))
    found = bound_by(controller.step(), "position", "joint2")
    assert found.side == "lower"
    assert found.bound == pytest.approx(0.5)


def test_a_frozen_joint_is_said_to_be_frozen() -> None:
    controller = panda({}, {"name": "held", "type": "freeze", "joints": ["joint2"]})
    assert bound_by(controller.step(), "freeze", "joint2").bound == 0.0


def test_a_floating_base_is_held_by_the_limit_of_bases() -> None:
    controller = rmrc.Controller(problem("biped"))
    target = controller.problem.term["hand"].target[4:]
    for name in ("hand", "left", "right"):
        controller.set_target(name, controller.problem.term[name].target[4:] + [3.0, 0.0, 0.0])
    controller.set_target("hand", target + [3.0, 0.0, 0.0])
    bindings = controller.step().explain().bindings
    assert "base" in {binding.limit for binding in bindings}
    names = {name for binding in bindings if (name := binding.name) and binding.limit == "base"}
    assert len(names) == 1
    assert not names & {"left_knee", "right_knee"}


def test_the_speed_of_a_frame_names_its_task() -> None:
    controller = panda({"speed": {"hand": {"linear": 0.1}}})
    step = controller.step()
    [binding] = step.explain().bindings  # one limit, however many planes stand for it
    assert (binding.limit, binding.name, binding.side) == ("speed", "hand (linear)", "upper")
    assert binding.bound == 0.1
    [hand] = [task for task in step.explain().tasks if task.name == "hand"]
    assert hand.asked[0] == pytest.approx(10.0 * np.linalg.norm(FORWARD), rel=1e-6)
    assert hand.got[0] == pytest.approx(0.1, rel=1e-3)
    assert hand.error == tuple(step.error["hand"])


@each_backend
@each_robot
def test_every_active_limit_is_named(robot: str, backend: str) -> None:
    made = with_backend(problem(robot), backend)
    controller = rmrc.Controller(made)
    controller.set_target("hand", made.term["hand"].target[4:] + [0.5, 0.5, -0.5])
    for _ in range(12):
        step = controller.step()
        account = step.explain()
        assert account.status is step.status
        assert set(account.flags) == set(step.flags)
        assert list(account.flags) == sorted(step.flags, reverse=True)
        assert bool(account.bindings) is (Status.LIMITED in step.flags)
        joints = {made.model.joint(k).name for k in range(made.model.njnt)}
        previous = np.abs(step.moment.v_previous).max()
        for binding in account.bindings:
            assert binding.name in joints
            assert binding.limit in ("position", "velocity", "acceleration", "base")
            assert binding.multiplier > 0.0
            assert abs(binding.bound) <= previous + ACCELERATION * 10 * DT or robot in (
                "biped",
                "g1",
            )
        for task in account.tasks:
            assert task.error == tuple(step.error[task.name])
            for asked, got in zip(task.asked, task.got, strict=True):
                assert got <= asked * 1.5 + 0.1 or Status.LIMITED in step.flags
        for status in step.flags:
            assert f"{status.name}: {status.advice}" in str(account)


BUSY = {
    **LIMITS,
    "jerk": {"default": 2000.0},
    "workspace": [{"frame": {"site": "hand"}, "normal": [0.0, 0.0, 1.0], "offset": 0.45}],
    "speed": {"hand": {"linear": 0.4}},
    "collision": {"d_min": 0.005, "detect": 0.3},
}


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> rmrc.Problem:
    """A Panda beside a ball, with limits of every kind."""
    robot = beside_a_ball("panda", tmp_path_factory.mktemp("scenes"))
    damping = {"lambda": 0.01, "adapt": "sigma_min", "threshold": 0.3}
    return rmrc.compile(robot.config(limits=BUSY, damping=damping))


def drive(controller: rmrc.Controller, k: int) -> rmrc.Step:
    """Take step k of a motion whose target and obstacle move."""
    start = controller.problem.term["hand"].target[4:]
    swing = np.array([0.2 * np.sin(0.05 * k), 0.3 * np.cos(0.03 * k), -0.2])
    controller.set_target("hand", start + swing, velocity=np.full(6, 0.05))
    place, speed = start + [0.0, 0.16 - 0.002 * k, 0.0], [0.0, -1.0, 0.0, 0.0, 0.0, 0.3]
    controller.set_obstacle(BALL, place, velocity=speed)
    if k == 70:
        return controller.step(np.full(controller.problem.model.nq, np.nan))
    return controller.step()


@each_backend
def test_an_old_step_is_explained_as_a_new_one(busy: rmrc.Problem, backend: str) -> None:
    controller = rmrc.Controller(with_backend(busy, backend))
    steps, accounts = [], []
    for k in range(80):
        steps.append(drive(controller, k))
        accounts.append(steps[-1].explain())
    for step, account in zip(steps, accounts, strict=True):
        assert str(step.explain()) == str(account)
    controller.reset()
    assert str(steps[40].explain()) == str(accounts[40])
    kinds = {binding.limit for account in accounts for binding in account.bindings}
    assert {"jerk", "speed", "collision"} <= kinds


@each_backend
def test_explaining_leaves_no_trace(busy: rmrc.Problem, backend: str) -> None:
    asked, twin = (rmrc.Controller(with_backend(busy, backend)) for _ in range(2))
    steps = []
    for k in range(20, 60):
        first, second = drive(asked, k), drive(twin, k)
        assert first.flags == second.flags
        np.testing.assert_array_equal(first.v, second.v)
        steps.append(first)
        for step in (first, steps[len(steps) // 2], steps[0]):
            step.explain()


def test_what_the_curvature_adds_is_said(engine: Any) -> None:
    """It is the diagonal of X beside λ², and none where it is off."""
    for curvature in (True, False):
        made = problem("panda", "auto", *ROBOTS["panda"].tasks(), damping={"curvature": curvature})
        controller = rmrc.Controller(made, engine)
        assert controller.set_target("hand", made.term["hand"].target[4:] + 1.0)
        account = controller.step().explain()
        assert (account.curvature is not None) == curvature
        if account.curvature is not None:
            joint, added, square = account.curvature
            assert joint.startswith("joint")
            assert added > square == pytest.approx(1e-4)
            assert f"up to {added:.3g} more, at {joint}" in str(account)


def test_check_says_what_the_curvature_adds() -> None:
    said = "\n".join(check(rmrc.load(REPOSITORY / "configs" / "panda_line.yaml")))
    assert re.search(r"0\.1 m or rad off adds to λ² = 0\.0001: up to .* at joint\d for hand", said)
