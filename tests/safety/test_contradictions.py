"""The matrix of safety tests, contradictions: acceleration, velocity, position, rows, in order."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pydantic
import pytest
from matrix import (
    ACCELERATION,
    LIMITS,
    ROBOTS,
    ROUNDING,
    VELOCITY,
    Checked,
    each_backend,
    each_robot,
    problem,
    with_backend,
)
from numpy.typing import NDArray

import rmrc
from models import config
from rmrc import Problem, Status
from rmrc.engine.python import PythonEngine
from rmrc.model.extents import FINEST as PASSED

Array = NDArray[np.float64]

LONG = 0.01  # s
RETURNED = 120  # steps
FAST = 3.0  # rad/s, above v_max
NO_ACCELERATION = {key: value for key, value in LIMITS.items() if key != "acceleration"}


@lru_cache(maxsize=8)
def _made(robot: str, acceleration: bool) -> Problem:
    return problem(robot, dt=LONG, limits=LIMITS if acceleration else NO_ACCELERATION)


def ranged(made: Problem) -> NDArray[np.intp]:
    """Return the dofs (of the program) that have a range."""
    return np.flatnonzero(np.isfinite(made.box.lower))


@each_robot
@each_backend
def test_velocity_comes_before_position(robot: str, backend: str) -> None:
    # 0.1 rad outside, the position limit alone would ask for 0.1 · 0.95/dt = 9.5 rad/s.
    made = with_backend(_made(robot, acceleration=False), backend)
    joints, q = ranged(made), made.start.copy()
    q[made.box.coordinate[joints]] = made.box.upper[joints] + 0.1
    step = Checked(made, q).step()
    assert step.v[made.dofs[joints]] == pytest.approx(-VELOCITY)
    assert Status.RECOVERING in step.flags


@each_robot
@each_backend
def test_acceleration_comes_before_velocity(robot: str, backend: str) -> None:
    # As when the velocity limit is lowered while the robot moves.
    made = with_backend(_made(robot, acceleration=True), backend)
    fast = replace(made, box=replace(made.box, velocity=np.full(made.dofs.size, 2.0 * FAST)))
    joints, v = ranged(made), np.zeros(made.model.nv)
    v[made.dofs[joints]] = FAST
    q = made.start.copy()
    q[made.box.coordinate[joints]] = made.box.lower[joints] + 1e-3
    checked = Checked(fast, q, v)
    v = checked.step().v
    assert v[made.dofs[joints]].max() > FAST - ROUNDING - ACCELERATION * LONG
    slow = Checked(made, checked.q, v)
    while v[made.dofs[joints]].max() > VELOCITY:
        following = slow.step().v[made.dofs[joints]]
        above = v[made.dofs[joints]] > VELOCITY + ACCELERATION * LONG
        least = v[made.dofs[joints]] - ACCELERATION * LONG
        assert following[above] == pytest.approx(least[above])
        v = slow.v


@each_robot
@each_backend
def test_acceleration_comes_before_position(robot: str, backend: str) -> None:
    # From 2 rad/s at 15 rad/s² a joint needs 0.13 rad to stop, and has 0.01.
    made = with_backend(_made(robot, acceleration=True), backend)
    joints, v, q = ranged(made), np.zeros(made.model.nv), made.start.copy()
    moving = made.dofs[joints]
    v[moving] = VELOCITY
    q[made.box.coordinate[joints]] = made.box.upper[joints] - 0.01
    checked = Checked(made, q, v)
    for k in range(RETURNED):
        step = checked.step()
        assert Status.MAX_ITER not in step.flags
        braked = VELOCITY - (k + 1) * ACCELERATION * LONG
        if braked > 0.0:
            assert step.v[moving] == pytest.approx(braked)
    passed = 0.5 * VELOCITY**2 / ACCELERATION
    assert checked.outside(checked.q).max() <= ROUNDING
    assert passed > 0.01


@lru_cache(maxsize=8)
def _single(robot: str) -> tuple[str, Array, float, Array]:
    """Return a joint that moves the two parts of a robot apart, and where they overlap slightly.

    That is its name, q (nq,), the slope of the distance along it, and the slope of the hand's
    place (3,).
    """
    collision: dict[str, Any] = {"pairs": [ROBOTS[robot].pair], "detect": 5.0}
    far = problem(robot, dt=LONG, limits={"collision": collision})
    engine, box, q = PythonEngine(far), far.box, far.start.copy()
    hinges = np.isfinite(box.lower)
    place = box.coordinate[hinges]
    for _ in range(500):
        engine.prepare(q, np.zeros(far.model.nv), LONG)
        near = engine.rows.blocks[0].near
        nearest = int(np.argmin(near.distance))
        slope = near.slope[nearest][far.dofs[hinges]]
        if near.distance[nearest] < -0.001:
            break
        room = near.distance[nearest] + 0.002
        q[place] -= slope * min(room, 0.02) / (slope @ slope)
        q[place] = np.clip(q[place], box.lower[hinges] + 0.1, box.upper[hinges] - 0.1)
    else:
        raise AssertionError("the two parts do not come together")
    dof = int(far.dofs[hinges][np.argmax(np.abs(slope))])
    jacobian = np.zeros((3, far.model.nv))
    frame = far.term["hand"].frame  # type: ignore[attr-defined]
    frame.jacobian(far.model, engine.evaluation.data, jacobian, None, frame.id)
    name = far.model.joint(far.model.dof_jntid[dof]).name
    return name, q, float(near.slope[nearest][dof]), jacobian[:, dof].copy()


@each_robot
@each_backend
def test_a_joint_limit_comes_before_a_collision(robot: str, backend: str) -> None:
    # One joint, whose range is further into the obstacle.
    joint, q, slope, _ = _single(robot)
    collision = {"pairs": [ROBOTS[robot].pair]}
    made = problem(robot, backend, dt=LONG, dofs=[joint], limits={**LIMITS, "collision": collision})
    there = float(q[made.box.coordinate[0]])
    inward = -np.sign(slope)
    end = np.array([there + 0.1 * inward])
    box = replace(made.box, lower=end, upper=end)
    checked = Checked(replace(made, box=box), q)
    outside, before = checked.outside(q)[0], distances(checked, q)
    assert outside == pytest.approx(0.1)
    for k in range(RETURNED):
        step = checked.step()
        assert Status.MAX_ITER not in step.flags
        assert (Status.RECOVERING in step.flags) >= (outside > 2.0 * ROUNDING)
        after = distances(checked, checked.q)
        if (after < np.minimum(before, 0.0) - PASSED).any():
            assert Status.RELAXED in step.flags
        if k == 0:
            assert step.v[made.dofs] == pytest.approx(inward * ACCELERATION * LONG)
            assert Status.RELAXED in step.flags
        assert checked.outside(checked.q)[0] <= outside
        outside, before = checked.outside(checked.q)[0], after
    assert outside <= ROUNDING


def distances(checked: Checked, q: Array) -> Array:
    """Return how far all pairs are above their least distance at q (nq,), m."""
    model, barrier = checked.problem.model, checked.controller.engine.rows.barriers[0]
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return barrier.distances(data, np.arange(len(checked.problem.barriers[0].geoms)))  # type: ignore


@each_robot
@each_backend
def test_a_workspace_against_a_collision_is_relaxed(robot: str, backend: str) -> None:
    # One joint: what leads out of the obstacle leads out of the workspace.
    joint, q, slope, hand = _single(robot)
    data = mujoco.MjData(problem(robot).model)
    normal = -np.sign(slope) * hand / np.linalg.norm(hand)
    model = problem(robot).model
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    frame = problem(robot).term["hand"].frame  # type: ignore[attr-defined]
    offset = float(normal @ frame.views(data)[0]) + 0.01
    plane = {"frame": ROBOTS[robot].hand, "normal": normal.tolist(), "offset": offset}
    collision = {"pairs": [ROBOTS[robot].pair]}
    made = problem(
        robot,
        backend,
        dt=LONG,
        dofs=[joint],
        limits={**LIMITS, "workspace": [plane], "collision": collision},
    )
    checked = Checked(made, q)
    for _ in range(10):
        step = checked.step()
        assert Status.RELAXED in step.flags
        assert Status.MAX_ITER not in step.flags


@each_robot
@each_backend
def test_a_range_of_one_point_is_kept(robot: str, backend: str) -> None:
    base = _made(robot, acceleration=True)
    names = [base.model.joint(j).name for j in base.model.dof_jntid[base.dofs[ranged(base)]]]
    points = base.start[base.box.coordinate[ranged(base)]]
    points[::2] = np.clip(points[::2] + 0.05, None, base.box.upper[ranged(base)][::2])
    limits = {**LIMITS, "position": {n: [p, p] for n, p in zip(names, points, strict=True)}}
    made = problem(robot, backend, dt=LONG, limits=limits)
    checked = Checked(made)
    hand = made.forward(checked.q)["hand"]
    hand[:3, 3] += [0.2, 0.1, -0.1]
    checked.aim(hand)
    for _ in range(40):
        assert Status.MAX_ITER not in checked.step().flags
    step = checked.step()
    assert checked.q[made.box.coordinate[ranged(made)]] == pytest.approx(points, abs=ROUNDING)
    assert np.abs(step.v[made.dofs[ranged(made)]]).max() <= ROUNDING / LONG


@each_robot
def test_a_range_that_is_upside_down_is_an_error(robot: str) -> None:
    made = _made(robot, acceleration=True)
    joint = made.model.joint(made.model.dof_jntid[made.dofs[ranged(made)[0]]]).name
    position: dict[str, Any] = {joint: [0.5, -0.5]}
    with pytest.raises(pydantic.ValidationError, match=f"range of '{joint}' is .lower, upper."):
        ROBOTS[robot].config(limits={"position": position})


@each_robot
def test_a_margin_that_leaves_no_range_is_an_error(robot: str) -> None:
    config = ROBOTS[robot].config(limits={"position": {"margin": 10.0}})
    with pytest.raises(rmrc.ConfigError, match="too short for a margin of 10"):
        rmrc.compile(config)


def test_what_cannot_hold_is_missed_by_the_least_and_never_left_out(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The Python engine does not fall to the box alone where there is a least violation."""

    def left_out(*_: object) -> None:
        raise AssertionError("the box alone")

    monkeypatch.setattr(PythonEngine, "_without_rows", left_out)
    rng, relaxed = np.random.default_rng(0), 0
    for _ in range(8):
        hard = {"type": "frame", "hard": True, "B": {"position": 1.0, "orientation": 0.0}}
        tasks = [
            {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
            *({"name": body, **hard, "frame": {"body": body}} for body in ("link5", "link4")),
        ]
        plane = {"frame": {"site": "hand"}, "normal": rng.normal(size=3).tolist()}
        limits = {
            "velocity": {"default": float(rng.uniform(0.05, 2.0))},
            "speed": {"hand": {"linear": float(10.0 ** rng.uniform(-3.0, 0.0))}},
            "workspace": [{**plane, "offset": float(rng.uniform(-0.2, 0.8))}],
        }
        scene = str(repository / "scenes" / "panda.xml")
        problem = rmrc.compile(config(scene, tasks, start="home", dt=0.002, limits=limits))
        controller = rmrc.Controller(problem, "python")
        for name, term in problem.term.items():
            controller.set_target(name, term.target[4:] + rng.uniform(-0.5, 0.5, 3))
        for _ in range(6):
            relaxed += rmrc.Status.RELAXED in controller.step().flags
    assert relaxed > 20
