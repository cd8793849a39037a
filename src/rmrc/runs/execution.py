"""Execution: what becomes of a command, by plain integration or in MuJoCo's physics."""

import copy
import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.config.models import PushModel
from rmrc.control.step import Step
from rmrc.model.configuration import free_dofs
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.problem.start import start_keyframe
from rmrc.runs.joint_control import (
    ComputedTorque,
    JointControl,
    PositionServos,
    highest_bandwidth,
    without_servo,
)
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]

WHOLE = 1e-9
"""A ratio of two times that is this near a whole number is one."""


@dataclass(frozen=True, eq=False)
class State:
    """What is true of the robot when a step is taken."""

    q: Array
    """Configuration (nq,)."""
    v: Array
    """Velocity (nv,), rad/s or m/s."""
    error: Mapping[str, Array]
    """True errors of the tasks at q, by name."""
    q_commanded: Array | None
    """Set points of the joint controllers (nq,), None where they are q itself."""


class Execution(Protocol):
    """Carries commands out, one step of the control loop at a time."""

    notices: Sequence[str]
    """What a user should know."""
    fault: str | None
    """Why the run cannot go on, once that is so."""

    def feedback(self) -> Array | None:
        """Return the measured configuration (nq,), or None: the step starts where the last led."""
        ...

    def state(self, step: Step, targets: Mapping[str, Array]) -> State:
        """Return what is true when the step is taken, for the targets that it had."""
        ...

    def carry_out(self, step: Step) -> None:
        """Let the time of one step pass."""
        ...

    def place_obstacles(self, data: mujoco.MjData) -> None:
        """Take over where the mocap bodies are."""
        ...


def build_execution(problem: Problem) -> Execution:
    """Return what carries out the commands of a run, at its start.

    Raises:
        ConfigError: If the model cannot be driven as asked.
    """
    return Kinematic(problem) if problem.config.execute == "kinematic" else Actuated(problem)


class Kinematic:
    """The robot does what it is told: q becomes q ⊕ v dt."""

    notices: Sequence[str] = ()
    fault: str | None = None

    def __init__(self, problem: Problem):
        self._q = problem.start.copy()

    def feedback(self) -> None:
        """Return nothing: the step starts where the last one led."""

    def state(self, step: Step, targets: Mapping[str, Array]) -> State:
        """Return where the last step led; the step has the errors there."""
        return State(self._q, step.v, step.error, None)

    def carry_out(self, step: Step) -> None:
        """Move."""
        self._q = step.q

    def place_obstacles(self, data: mujoco.MjData) -> None:
        """Do nothing: here no obstacle is run into."""


class Actuated:
    """The robot in MuJoCo's physics, under joint controllers.

    A step's command v moves the set points q_c of the joint controllers, q_d = q_c ⊕ v dt, at an
    even speed through the step. q_c is integrated from the commands alone, in either kind of
    feedback:

    - measured: the step starts from the measured q, so the error that it corrects is the robot's.
      That q_c sums up the corrections makes the loop an integrator, and what a joint gives way
      under gravity or a push is taken back. With q_d = q ⊕ v dt instead, the set points would sink
      with the arm.
    - commanded: the step starts from q_c; the robot's own error is not seen.

    An integrator winds up where the joint cannot follow. With measured feedback a set point stays
    inside the joint's range, and goes no further ahead of its joint than where the force saturates:
    more would not move the joint, and would have to be taken back first. As in every such loop, the
    gain of a task must stay below the natural frequency of the joints' controllers, the more so the
    less they are damped and the older the measurement is.

    Measurements are late by `latency` steps and have normal noise. The joint controllers run at the
    rate of the physics on the joints' true state, as the drives of a robot do.

    Raises:
        ConfigError: If the model cannot be driven as asked.
    """

    def __init__(self, problem: Problem):
        options = problem.config.actuation
        self._problem = problem
        self._model = model = copy.copy(problem.model)
        self._substeps = max(1, math.ceil(problem.dt / model.opt.timestep - WHOLE))
        self.notices: Sequence[str] = self._shorten_timestep()
        self.fault: str | None = None
        self._measured = options.feedback == "measured"
        if mistakes := list(_mistakes(problem, model.opt.timestep)):
            raise config_error(mistakes, problem.config)
        self._joints: JointControl = (
            PositionServos(model)
            if options.joint_control == "position"
            else ComputedTorque(model, problem.dofs, options.bandwidth, options.damping_ratio)
        )
        self._data = _at_start(model, problem)
        self._set_points = problem.start.copy()
        self._push = _Push(model, options.push) if options.push is not None else None
        self._deviation = np.full(model.nv, options.noise)
        # Neither a floating body nor an object has an encoder.
        self._deviation[free_dofs(model)] = self._deviation[problem.objects.dofs] = 0.0
        self._random = np.random.default_rng(options.seed)
        delay = options.latency + 1
        self._measurements = deque([problem.start] * delay, maxlen=delay)
        self._truth = Evaluation(problem)

    def _shorten_timestep(self) -> list[str]:
        """Set the longest timestep up to the model's own that divides dt; return what to say."""
        option, dt = self._model.opt, self._problem.dt
        own, option.timestep = option.timestep, dt / self._substeps
        if abs(own / option.timestep - 1.0) < WHOLE:
            return []
        return [
            f"the physics runs in steps of {1e3 * option.timestep:.4g} ms: "
            f"dt is no multiple of the model's own {1e3 * own:.4g} ms"
        ]

    def feedback(self) -> Array | None:
        """Return the measured configuration (nq,), late and noisy; with `commanded`, nothing."""
        if not self._measured:
            return None
        q = self._data.qpos.copy()
        noise = self._random.normal(size=self._model.nv) * self._deviation
        mujoco.mj_integratePos(self._model, q, noise, 1.0)
        self._measurements.append(q)
        return self._measurements[0]

    def state(self, step: Step, targets: Mapping[str, Array]) -> State:
        """Return the state of the physics, and the errors there."""
        truth, data = self._truth, self._data
        for name, target in targets.items():
            truth.target[name][:] = target
        truth.v_previous[:] = data.qvel
        truth.update(data.qpos)
        truth.evaluate()
        error = {
            term.name: term.measure(truth.error_of(truth.error, term))
            for term in truth.terms
            if term.units
        }
        return State(data.qpos, data.qvel, error, self._set_points)

    def carry_out(self, step: Step) -> None:
        """Move the set points, and run the physics for one step of the control loop."""
        model, data = self._model, self._data
        v = self._followed(step.v) if self._measured else step.v
        warnings: list[str] = []
        with _warnings_to(warnings):
            for _ in range(self._substeps):
                mujoco.mj_step1(model, data)
                self._joints.drive(data, self._set_points, v)
                if self._push is not None:
                    self._push.apply(data)
                mujoco.mj_step2(model, data)
                mujoco.mj_integratePos(model, self._set_points, v, model.opt.timestep)
            mujoco.mj_checkPos(model, data)
            mujoco.mj_checkVel(model, data)
        if warnings:
            self.fault = f"the simulation failed, and the run ends there: {warnings[0]}"

    def place_obstacles(self, data: mujoco.MjData) -> None:
        """Put the mocap bodies of the physics where they are."""
        for own in (self._data, self._truth.data):
            own.mocap_pos[:], own.mocap_quat[:] = data.mocap_pos, data.mocap_quat

    def _followed(self, v: Array) -> Array:
        """Return the velocity (nv,) of the set points: v, held back where no joint can follow.

        The bounds never move a set point by themselves: one that is outside may stay.
        """
        box, dofs, dt = self._problem.box, self._problem.dofs, self._problem.dt
        at = self._data.qpos[box.coordinate]
        reach = self._joints.reach(self._data)[dofs]
        set_points = self._set_points[box.coordinate]
        back = np.minimum(np.maximum(box.lower, at - reach) - set_points, 0.0) / dt
        ahead = np.maximum(np.minimum(box.upper, at + reach) - set_points, 0.0) / dt
        followed = v.copy()
        followed[dofs] = np.clip(v[dofs], back, ahead)
        return followed


class _Push:
    """A wrench on a body through a window of time."""

    def __init__(self, model: mujoco.MjModel, push: PushModel):
        timestep = model.opt.timestep
        self._body = model.body(push.body).id
        self._wrench = np.array([*push.force, *push.torque])
        self._begin = push.start - 0.5 * timestep
        self._end = push.start + push.duration - 0.5 * timestep

    def apply(self, data: mujoco.MjData) -> None:
        """Set the wrench for the step of the physics that begins now."""
        inside = self._begin <= data.time < self._end
        data.xfrc_applied[self._body] = self._wrench if inside else 0.0


def _mistakes(problem: Problem, timestep: float) -> Iterator[Mistake]:
    """Yield what cannot be driven as asked, or pushed."""
    model, options = problem.model, problem.config.actuation
    if np.isin(problem.dofs, free_dofs(model)).any():
        yield Mistake(
            ("execute",),
            "a floating base has no joint controller; `actuated` needs a robot that stands fixed, "
            "or `dofs` without the base",
        )
    elif options.joint_control == "position" and (bare := without_servo(model, problem.dofs)):
        yield Mistake(
            ("actuation", "joint_control"),
            f"joints without a position actuator: {', '.join(bare)}; leave them out of `dofs`, or "
            "take `torque`",
        )
    if options.joint_control == "torque":
        highest = highest_bandwidth(options.damping_ratio, timestep)
        if options.bandwidth >= highest:
            yield Mistake(
                ("actuation", "bandwidth"),
                f"in steps of {1e3 * timestep:.4g} ms, the physics is stable up to a bandwidth of "
                f"{highest:.4g} rad/s",
            )
    if options.push is not None and model.body(options.push.body).weldid == 0:
        yield Mistake(
            ("actuation", "push", "body"),
            f"body '{options.push.body}' is fixed to the world, and no push moves it",
        )


def _at_start(model: mujoco.MjModel, problem: Problem) -> mujoco.MjData:
    """Return the physics at rest at the start.

    Actuators that no joint controller uses keep the controls of the keyframe, if there is one.
    """
    data = mujoco.MjData(model)
    keyframe = start_keyframe(model, problem.config.start)
    if keyframe is not None:
        mujoco.mj_resetDataKeyframe(model, data, keyframe)
    data.qpos[:], data.qvel[:], data.time = problem.start, 0.0, 0.0
    mujoco.mj_forward(model, data)
    return data


@contextmanager
def _warnings_to(said: list[str]) -> Iterator[None]:
    """Collect what MuJoCo warns of, which would go to the terminal and into a file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
