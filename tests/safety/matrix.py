"""The robots and backends of the safety tests, and what holds at every step of every one."""

from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config
from rmrc import Problem, Status, Step
from rmrc.engine.python import CERTIFIED

Array = NDArray[np.float64]

# What a limit may be passed by, rad, m and their rates: sums of a few roundings.
ROUNDING = 1e-9
DT = 0.002  # s
VELOCITY, ACCELERATION = 2.0, 15.0  # rad/s and rad/s², m/s and m/s²
LIMITS = {
    "velocity": {"default": VELOCITY},
    "acceleration": {"default": ACCELERATION},
    "base": {"linear": 1.0, "angular": 1.0},
}
# Statuses that say that a solution is not certified.
UNCERTAIN = {Status.MAX_ITER, Status.DEADLINE, Status.STALE, Status.INVALID_INPUT}

BACKENDS = ("auto", "daqp", "proxqp", "osqp")


@dataclass(frozen=True)
class Robot:
    """A robot, the frame that is its hand, and two parts of it that can collide."""

    scene: str
    hand: dict[str, str]
    pair: tuple[str, str]
    """Bodies or geoms that a configuration can bring together."""
    others: dict[str, dict[str, str]] = field(default_factory=dict)
    """Further frames that hold their places, by task."""
    start: str = "home"
    arm: tuple[str, ...] | None = None
    """The joints between the root and the hand; all where it is None."""

    def tasks(self, **hand: Any) -> list[dict[str, Any]]:
        """Return the tasks: the hand's, those of the further frames and a posture."""
        frames = {"hand": self.hand, **self.others}
        tasks = [{"name": name, "type": "frame", "frame": at} for name, at in frames.items()]
        tasks = [{**task, "gain": 10.0, "axes": "world"} for task in tasks]
        tasks[0] |= hand
        return [*tasks, {"name": "posture", "type": "posture", "B": 0.01, "gain": 1.0}]

    def config(self, *tasks: dict[str, Any], **others: Any) -> rmrc.Config:
        """Return a configuration with `LIMITS`; without tasks, with all of `tasks()`."""
        options = {"start": self.start, "dt": DT, "limits": LIMITS, **others}
        return config(self.scene, list(tasks) or self.tasks(), **options)


def _scene(name: str) -> str:
    return str(REPOSITORY / "scenes" / f"{name}.xml")


def _joints(prefix: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{prefix}{name}" for name in names)


ROBOTS = {
    "panda": Robot(_scene("panda"), {"site": "hand"}, ("gripper", "floor")),
    "ur5e": Robot(_scene("ur5e"), {"site": "tool"}, ("wrist_3_link", "floor")),
    "biped": Robot(
        _scene("biped"),
        {"site": "left_hand"},
        ("left_hand", "right_hand"),
        {"left": {"site": "left_foot"}, "right": {"site": "right_foot"}},
        arm=_joints(
            "left_",
            *("shoulder_pitch", "shoulder_roll", "shoulder_yaw"),
            *("elbow", "wrist_yaw", "wrist_pitch"),
        ),
    ),
    "dual_arm": Robot(
        _scene("dual_arm"),
        {"site": "left_hand"},
        ("left_gripper", "obstacle_1"),
        {"right": {"site": "right_hand"}},
        arm=_joints("left_joint", *"1234567"),
    ),
    "real_panda": Robot(
        "menagerie:franka_emika_panda/scene", {"site": "attachment_site"}, ("link7", "floor")
    ),
    "g1": Robot(
        "menagerie:unitree_g1/g1",
        {"site": "left_palm"},
        ("left_elbow_roll_link", "right_elbow_roll_link"),
        {"left": {"site": "left_foot"}, "right": {"site": "right_foot"}},
        start="stand",
        arm=_joints(
            "left_",
            *("shoulder_pitch_joint", "shoulder_roll_joint", "shoulder_yaw_joint"),
            *("elbow_pitch_joint", "elbow_roll_joint"),
        ),
    ),
    "aloha": Robot(
        "menagerie:aloha/scene",
        {"site": "left/gripper"},
        ("left/gripper_base", "table"),
        {"right": {"site": "right/gripper"}},
        start="neutral_pose",
        arm=_joints(
            "left/",
            *("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"),
        ),
    ),
}
"""Ours by the names of their scenes, and the Menagerie's."""

each_robot = pytest.mark.parametrize("robot", ROBOTS)
each_backend = pytest.mark.parametrize("backend", BACKENDS)


def problem(robot: str, backend: str = "auto", *tasks: dict[str, Any], **others: Any) -> Problem:
    """Return the problem of a robot's configuration."""
    return with_backend(rmrc.compile(ROBOTS[robot].config(*tasks, **others)), backend)


def with_backend(made: Problem, backend: str) -> Problem:
    """Return the same problem for another solver."""
    solver = made.config.solver.model_copy(update={"backend": backend})
    return replace(made, config=made.config.model_copy(update={"solver": solver}))


class Checked:
    """A controller whose every step is held to what a step promises.

    v is finite, keeps the acceleration limit, and the velocity limit where the acceleration limit
    lets it; a joint inside its range stays there, and one outside gets no further out once it
    turned back; the solution is certified or the status says that it is not.
    """

    def __init__(self, made: Problem, q: Array | None = None, v: Array | None = None):
        self.problem, self.controller = made, rmrc.Controller(made)
        self.reset(q, v)

    def reset(self, q: Array | None = None, v: Array | None = None) -> None:
        """Start anew, at the problem's start and at rest unless told otherwise."""
        self.controller.reset(q, v)
        self.v = np.zeros(self.problem.model.nv) if v is None else np.array(v, dtype=float)
        self.q = self.controller.q

    def aim(self, pose: Array, name: str = "hand") -> None:
        """Set a target (4, 4)."""
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).ravel())
        assert self.controller.set_target(name, pose[:3, 3], quaternion)

    def outside(self, q: Array) -> Array:
        """Return how far each of the dofs (n,) is outside its range at q, rad or m."""
        box = self.problem.box
        place = q[box.coordinate]
        return np.maximum(np.maximum(box.lower - place, place - box.upper), 0.0)

    def step(self, q: Array | None = None, dt: float | None = None, **others: Any) -> Step:
        """Take a step and check it."""
        before = self.q if q is None else np.array(q, dtype=float)
        step = self.controller.step(q, dt, **others)
        seconds = self.problem.dt if dt is None else dt
        self._check(step, before, seconds)
        self.v, self.q = step.v.copy(), step.q.copy()
        return step

    def _check(self, step: Step, q: Array, dt: float) -> None:
        box, dofs, model = self.problem.box, self.problem.dofs, self.problem.model
        v, previous = step.v[dofs], self.v[dofs]
        assert step.v.shape == (model.nv,)
        assert np.isfinite(step.v).all()
        assert np.isfinite(step.q).all()
        still = np.setdiff1d(np.arange(model.nv), dofs)
        assert not step.v[still].any()
        change = box.acceleration * dt
        assert (np.abs(v - previous) <= change + ROUNDING).all()
        assert (np.abs(v) <= np.maximum(box.velocity, np.abs(previous) - change) + ROUNDING).all()
        now, then = self.outside(q), self.outside(step.q)
        stops = self._stoppable(q, previous)
        assert (then[stops] <= ROUNDING).all()
        side = np.where(q[box.coordinate] > box.upper, 1.0, -1.0)
        back = (now > 0.0) & (side * previous <= 0.0)
        assert (then[back] <= now[back] + ROUNDING).all()
        if not step.flags & UNCERTAIN:
            kkt = step.solution.kkt
            scale = max(1.0, float(np.linalg.norm(self.controller.engine.assembly.qp.g)))
            assert kkt.primal <= CERTIFIED
            assert max(kkt.dual, kkt.complementarity) <= CERTIFIED * scale

    def _stoppable(self, q: Array, v: Array) -> NDArray[np.bool_]:
        """Return which dofs (n,) are in their range and can stop in it: v²/2a ≤ room."""
        box = self.problem.box
        place = q[box.coordinate]
        room = np.where(v > 0.0, box.upper - place, place - box.lower)
        way = 0.5 * v * v / box.acceleration
        return (self.outside(q) == 0.0) & (way <= room + ROUNDING)
