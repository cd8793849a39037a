"""`Controller`: one certified joint velocity a step, whatever comes in."""

import math
from collections.abc import Mapping
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmrc.config.models import Config
from rmrc.control.context import Moment
from rmrc.control.engines import Choice, build_engine
from rmrc.control.fast.calls import quick_step, quick_target
from rmrc.control.inputs import (
    LARGEST,
    Configurations,
    Targets,
    as_arguments,
    counted_from,
)
from rmrc.control.jog import Frames, Jog
from rmrc.control.numbers import LONGEST, SHORTEST, number, seconds_of, told
from rmrc.control.progress import Progress
from rmrc.control.status import ACTIVE_MULTIPLIER, Status
from rmrc.control.step import Made, Step
from rmrc.control.tuning import weight_of, with_limits, with_task
from rmrc.engine.closed_form import UNCERTIFIED
from rmrc.errors import ModelError, RmrcError, unknown_name
from rmrc.limits.box import braked
from rmrc.limits.contacts import ELSEWHERE
from rmrc.model.frames import names
from rmrc.problem.compile import recompile
from rmrc.problem.problem import Problem
from rmrc.qp.program import Solution, SolveStatus

if TYPE_CHECKING:
    from rmrc._native import Stepper
    from rmrc.native.engine import NativeEngine

Array = NDArray[np.float64]

_STATE = (
    *("_clock", "_measured_at", "_set_at", "_measured", "_last_rate", "_refused"),
    *("_holds", "_switched_off", "failures"),
)
"""What a controller keeps beside its arrays when its configuration changes."""

MOST_TOLD = 8
"""Inputs that were refused since the last step, and are told of."""
TICK_ROUNDING = 1e-9
"""A timeout that is passed by less than this, s, is not passed: ticks are summed up."""

_LIMITED = 1 << Status.LIMITED
_SCALED = 1 << Status.SCALED
_DAMPED = 1 << Status.DAMPED
_RELAXED = 1 << Status.RELAXED
_STUCK = 1 << Status.STUCK
_DEADLINE = 1 << Status.DEADLINE
_STALE = 1 << Status.STALE
_RECOVERING = 1 << Status.RECOVERING
_MAX_ITER = 1 << Status.MAX_ITER
_INVALID_INPUT = 1 << Status.INVALID_INPUT
FAILED = _MAX_ITER | _DEADLINE | _STALE | _INVALID_INPUT
"""Bits of the statuses without a certified solution."""
_SOLVED = SolveStatus.SOLVED  # to look it up takes 0.1 µs


class Controller:
    """Solves a problem step by step, for a control loop at 100 to 1000 Hz.

    `step` and `set_target` never raise for what a caller can meet at run time; they answer with a
    `Status`. Only a name that does not exist raises.
    """

    def __init__(self, problem: Problem, engine: Choice = "auto"):
        self.problem = problem
        self.engine, self.notices = build_engine(problem, engine)
        model = problem.model
        self._model, self._evaluation = model, self.engine.evaluation
        self._all, self._objects = problem.dofs.size == model.nv, problem.objects.dofs
        self._configurations = Configurations(model)
        self._targets = Targets(self._evaluation, self._configurations)
        frozen = problem.box.velocity == 0.0
        self._frozen = frozen if frozen.any() else None
        self._refused: tuple[str, ...] = ()  # what is wrong with inputs since the last step
        self._term = dict(problem.term)
        self._obstacle = {
            name: int(model.body(name).mocapid[0]) for name in names(model, "mocap body")
        }
        self._budget = problem.deadline
        self._timed = min(problem.target_timeout, problem.measurement_timeout) < math.inf
        self._adapts = problem.config.damping.adapt != "off"
        self._jerk = bool(np.isfinite(problem.box.jerk).any())
        self._measures = problem.config.previous == "measured"
        self._lag = problem.lag if problem.lag.any() else None
        self._elsewhere = ELSEWHERE * float(problem.box.velocity.max(initial=0.0))
        self._q, self._v, self._a = np.empty(model.nq), np.empty(model.nv), np.zeros(model.nv)
        self._choice: Choice = engine
        self._switched_off: dict[str, Any] = {}
        self._frames = Frames(problem, self._evaluation.data)
        self._jog, self._holds = Jog(self._frames), False
        self._fast = self.stepper = self._new_stepper()
        """What takes the common steps in the extension; None while Python takes them all."""
        self._progress = self._fast or Progress(problem, self._evaluation, self.engine.assembly)
        self.failures = 0
        """Steps in a row, up to the last, that ended without a certified solution."""
        self.reset()

    def _new_stepper(self) -> "Stepper | None":
        if not self.engine.steps_alone:
            return None
        from rmrc.control.fast.steps import build_stepper  # there is the extension

        return build_stepper(cast("NativeEngine", self.engine), self._q, self._v)

    def __reduce__(self) -> NoReturn:
        raise RmrcError(
            "a Controller cannot be copied or pickled: it holds the memory of a solver. "
            "Make another with Controller(problem) and `reset` it to the same q and v"
        )

    def reset(
        self,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        a: ArrayLike | None = None,
    ) -> None:
        """Start anew at q (nq,), by default the start of the config; targets return to theirs.

        Args:
            q: Configuration (nq,).
            v: Velocity (nv,) that the robot moves with; by default it rests.
            a: Its acceleration (nv,).

        Raises:
            ModelError: If q, v or a does not fit this model.
        """
        evaluation = self._evaluation
        if q is not None:
            valid = self._configurations.read(q)
            if valid is None:
                raise ModelError(
                    f"q must be {self._configurations.size} finite numbers with no zero quaternion"
                )
            self._q[:] = valid
        else:
            self._q[:] = self.problem.start
        self._v[:], self._a[:] = self._rates("v", v), self._rates("a", a)
        self._v[self._objects] = self._a[self._objects] = 0.0
        self._refused = ()
        self._jog.forget()
        self._holds = False
        self._choose_stepper()
        self._clock = self._measured_at = 0.0
        self._set_at: dict[str, float] = {}
        self._measured: Array | None = None
        self._last_rate = self._v.copy()
        self.failures = 0
        model, data = self._model, evaluation.data
        for name, mocap in self._obstacle.items():
            body = model.body(name).id
            data.mocap_pos[mocap], data.mocap_quat[mocap] = (
                model.body_pos[body],
                model.body_quat[body],
            )
        evaluation.obstacle_twist[:] = 0.0
        for term in self.problem.terms:
            evaluation.target[term.name][:] = term.target
            evaluation.stop(term.name)
        self._progress.reset()  # which looks whether the targets move from here
        self.engine.reset()

    def _rates(self, name: str, rates: ArrayLike | None) -> Array:
        """Return rates (nv,) that are given, or zeros."""
        if rates is None:
            return np.zeros(self._model.nv)
        valid = self._configurations.read_velocity(rates)
        if valid is None:
            raise ModelError(f"{name} must be {self._model.nv} numbers below {LARGEST:g} in size")
        return valid

    @quick_target  # tries `stepper` first
    def set_target(
        self,
        name: str,
        position: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        *,
        q: ArrayLike | None = None,
        direction: ArrayLike | None = None,
    ) -> bool:
        """Set a task's target; return False, and keep the last good one, if it is not valid.

        Args:
            name: The task.
            position: Of a pose or a point (3,), m, in the world or in the root's coordinates.
            quaternion: Of a pose (4,), wxyz, of any norm but zero.
            velocity: The target's own velocity as feed-forward: of a pose (6,), linear then
                angular, m/s and rad/s, in the axes of the position; of a point (3,), m/s; of a
                direction (3,), rad/s; or the rates (nv,) of a `velocity` task.
            q: Configuration (nq,) of a `posture` task.
            direction: Direction (3,) of an `axis_align` task.

        Raises:
            ModelError: If there is no such task.
        """
        term = self._term.get(name) or self.problem.named(name)
        if self._jog.active:
            self._jog.forget(name)
            self._choose_stepper()
        accepted = self._targets.take(term, position, quaternion, velocity, q, direction)
        if not accepted:
            what = self._targets.fault(term, position, quaternion, velocity, q, direction)
            self._refused = (*self._refused[: MOST_TOLD - 1], what)
        elif self._timed:
            self._set_at[name] = self._clock
        return accepted

    def set_obstacle(
        self,
        name: str,
        position: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
    ) -> bool:
        """Move a mocap body; return False, and leave it where it is, if the pose is not valid.

        Args:
            name: The body.
            position: In the world (3,), m; by default as it is.
            quaternion: wxyz (4,), of any norm but zero; by default as it is.
            velocity: Its linear and angular velocity in the world (6,), m/s and rad/s; by default
                it rests.

        Raises:
            ModelError: If the model has no such mocap body.
        """
        if name not in self._obstacle:
            raise ModelError(unknown_name("mocap body", name, self._obstacle))
        mocap, evaluation = self._obstacle[name], self._evaluation
        data = evaluation.data
        pose = self._targets.pose(
            data.mocap_pos[mocap], data.mocap_quat[mocap], position, quaternion, velocity
        )
        if pose is None:
            what = self._targets.pose_fault(name, position, quaternion, velocity)
            self._refused = (*self._refused[: MOST_TOLD - 1], what)
            return False
        data.mocap_pos[mocap], data.mocap_quat[mocap] = pose[:3], pose[3:7]
        evaluation.obstacle_twist[mocap] = pose[7:]
        return True

    @quick_step  # tries `stepper` first
    def step(
        self,
        q: ArrayLike | None = None,
        dt: float | None = None,
        v: ArrayLike | None = None,
        age: float = 0.0,
    ) -> Step:
        """Return the command for the next step of dt seconds.

        Args:
            q: Measured configuration (nq,); by default the one that the last command led to.
            dt: Length of the step, s; by default the problem's.
            v: Measured velocity (nv,), for `previous: measured` and `lag`; by default what the
                last two measured configurations say.
            age: Age of the measured configuration, s.
        """
        if self._holds:
            return self.command(np.zeros(self._model.nv), q, dt)
        self._begin()
        valid = self._q.copy() if q is None else self._configurations.read(q)
        seconds = self.problem.dt if dt is None else seconds_of(dt)
        if valid is None:
            return self._refuse(seconds, self._configurations.fault("q", q))
        if seconds is None:
            return self._refuse(seconds, _no_time(dt))
        dt = seconds
        if np.abs(valid - self._q).max() > self._elsewhere * dt:
            for barrier in self.engine.rows.barriers:
                barrier.forget()
        previous = self._v.copy()
        if self._measures or self._lag is not None:
            rate = self._rate(q is not None, valid, v, dt)
            if rate is None:
                return self._refuse(dt, self._configurations.velocity_fault("v", v))
            if self._measures:
                previous = counted_from(rate, self._last_rate, self._v)
                self._last_rate = rate
            if self._lag is not None and q is not None:
                # What y = q ⊕ lag·v does is v itself, so that all limits hold as without a lag.
                mujoco.mj_integratePos(self._model, valid, self._lag * rate, 1.0)
        if self._timed:
            stale = self._stale(q is not None, age)
            if stale is None:
                return self._refuse(dt, f"age is {told(age)}, and no time in s")
            if stale:
                return self._brake(dt, _STALE)
        if self._jerk:
            self._evaluation.a_previous[:] = self._a
        if self._jog.active:
            for name, position, quaternion, twist in self._jog.targets(valid, self._v):
                term = self._term[name]
                self._targets.take(term, position, quaternion, twist, None, None)
                self._set_at[name] = self._clock
            self._choose_stepper()
        return self._solved(valid, previous, dt)

    @np.errstate(all="ignore")  # what is not finite shows in the residuals
    def _solved(self, q: Array, previous: Array, dt: float) -> Step:
        """Return a step of dt seconds from a valid q (nq,)."""
        solution = self.engine.solve(q, previous, dt)
        if refused := self.engine.evaluation.refused:
            self._refused += tuple(refused)
            self._progress.reset()
        else:
            self._progress.update(solution.v, dt)
        return self._carried_out(q, solution, self._flags(solution), dt, previous)

    def _begin(self) -> None:
        """Have what follows end in the time that a step may take."""
        if self._budget < math.inf:
            self.engine.deadline = perf_counter() + self._budget

    def _rate(self, measured: bool, q: Array, v: ArrayLike | None, dt: float) -> Array | None:
        """Return the measured velocity, the last command without one; None if v is not valid."""
        before, self._measured = self._measured, q.copy() if measured else None
        if v is not None:
            found = self._configurations.read_velocity(v)
        elif before is None or not measured:
            return self._v.copy()
        else:
            found = np.empty(self._model.nv)
            mujoco.mj_differentiatePos(self._model, found, dt, before, q)
        if found is not None:
            found[self._objects] = 0.0  # what moves an object is no motion of the robot's
        return found

    def _stale(self, measured: bool, age: object) -> bool | None:
        """Return whether the measurement or a target that was set is older than its timeout.

        None if the age of the measurement is no age.
        """
        problem, now = self.problem, self._clock
        if measured:
            seconds = number(age)
            if seconds is None or not seconds >= 0.0:  # NaN is not
                return None
            self._measured_at = now - seconds
        oldest = min(self._set_at.values(), default=now)
        return (
            now - oldest > problem.target_timeout + TICK_ROUNDING
            or now - self._measured_at > problem.measurement_timeout + TICK_ROUNDING
        )

    def _carried_out(
        self, q: Array, solution: Solution, flags: int, dt: float, previous: Array
    ) -> Step:
        """Integrate a solution over dt from q, and remember where it leads."""
        if self._all:
            v = solution.v
        else:
            v = np.zeros(self._model.nv)
            v[self.problem.dofs] = solution.v
        following = q.copy()
        mujoco.mj_integratePos(self._model, following, v, dt)
        acceleration = self._a.copy()
        if self._jerk:
            self._a[:] = (v - previous) / dt
        self._q[:], self._v[:] = following, v
        self._clock += dt
        self.failures = self.failures + 1 if flags & FAILED else 0
        moment = Moment(self.engine, q, previous, acceleration, dt, invalid=self._refused)
        self._refused = ()
        return Step(Made(v, following, solution, moment), flags)

    @property
    def q(self) -> Array:
        """The configuration (nq,) that the last command led to."""
        return self._q.copy()

    def set_targets(self, targets: Mapping[str, ArrayLike | Mapping[str, ArrayLike]]) -> bool:
        """Set targets of several tasks at once; return whether all were valid.

        Args:
            targets: By task: the arguments of `set_target` by name, or of a `frame` task its pose,
                a matrix (4, 4) or xyz and wxyz (7,).

        Raises:
            ModelError: If there is no such task; then none is set.
        """
        given = {
            self.problem.named(name).name: as_arguments(value) for name, value in targets.items()
        }
        accepted = [self.set_target(name, **each) for name, each in given.items()]
        return all(accepted)

    def tune(self, name: str, *, enabled: bool | None = None, **changes: Any) -> None:
        """Change a task from the next step on; targets, q, v and all else stay.

        Args:
            name: The task.
            enabled: False switches the task off, its B to 0; True brings it back.
            changes: Its keys as in the configuration: B, gain, level, clamp, ….

        The engine is made anew, which takes milliseconds (see `docs/running.md`).

        Raises:
            ModelError: If there is no such task, or it has no weight to switch it off by.
            ConfigError: If a key or a value is wrong, or does not fit the model; nothing changes.
        """
        if enabled is False and name not in self._switched_off:
            weight = weight_of(self.problem.config, name)
            self._adopt(with_task(self.problem.config, name, {**changes, "B": 0.0}))
            self._switched_off[name] = changes.get("B", weight)
            return
        if enabled and name in self._switched_off:
            changes = {"B": self._switched_off[name], **changes}
        elif name in self._switched_off and "B" in changes:
            self._switched_off[name] = changes.pop("B")  # for when it is switched on
        self._adopt(with_task(self.problem.config, name, changes))
        if enabled:
            self._switched_off.pop(name, None)

    def limit(self, **changes: Any) -> None:
        """Change limits from the next step on; each key replaces that of `limits` whole.

        Args:
            changes: Keys of `limits` as in the configuration: velocity, acceleration, jerk,
                position, base, speed, workspace, and of `collision` the keys that change.

        The engine is made anew, which takes milliseconds (see `docs/running.md`).

        Raises:
            ConfigError: If a key or a value is wrong, or does not fit the model; nothing changes.
        """
        self._adopt(with_limits(self.problem.config, changes))

    def _adopt(self, config: Config) -> None:
        """Go on with another configuration of the same model and tasks, from the present state."""
        other = Controller(recompile(self.problem, config), self._choice)
        ours, theirs = self._evaluation, other._evaluation
        for name in ("targets", "twists", "obstacle_twist"):
            getattr(theirs, name)[:] = getattr(ours, name)
        theirs.moving[:] = ours.moving
        theirs.data.mocap_pos, theirs.data.mocap_quat = ours.data.mocap_pos, ours.data.mocap_quat
        other._q[:], other._v[:], other._a[:] = self._q, self._v, self._a
        for name in _STATE:
            setattr(other, name, getattr(self, name))
        other._jog = self._jog.among(other._frames)
        other._choose_stepper()
        if "step" in self.__dict__:  # a recorder's
            other.__dict__["step"] = self.__dict__["step"]
        self.__dict__ = other.__dict__

    def set_twist(self, name: str, twist: ArrayLike) -> bool:
        """Jog a task's frame: its target moves along with it, until `set_target` is called.

        At a twist of zero the frame is held where it stops. Steps of a frame that is jogged are
        taken with a part in Python.

        Args:
            name: A `frame` task.
            twist: [linear; angular] (6,) in the world's axes, m/s and rad/s. Where it is not six
                finite numbers the last one stays, and the next step says INVALID_INPUT.

        Raises:
            ModelError: If there is no such task, or it has no pose for a target.
        """
        term = self.problem.named(name)
        if term.type != "frame":
            raise ModelError(f"task '{name}' is a {term.type}: set_twist moves `frame` tasks")
        try:
            valid = np.array(twist, dtype=float)
        except (TypeError, ValueError):
            valid = np.empty(0)
        if valid.shape != (6,) or not (np.abs(valid) < LARGEST).all():
            self._refused = (
                *self._refused[: MOST_TOLD - 1],
                f"twist of {name} is not six numbers below {LARGEST:g} in size",
            )
            return False
        self._jog.set(name, valid)
        self._choose_stepper()
        return True

    def hold(self) -> None:
        """Have the steps that follow brake inside the limits and stay, whatever the targets."""
        self._holds = True
        self._progress.reset()
        self._choose_stepper()

    def resume(self) -> None:
        """Go on after `hold`, from where the robot is."""
        self._holds = False
        self._progress.reset()
        self._choose_stepper()

    def _choose_stepper(self) -> None:
        self.stepper = None if self._holds or self._jog.active else self._fast

    def pose(self, name: str) -> Array:
        """Return the transformation (4, 4) in the world of a task's frame, where the last step led.

        Raises:
            ModelError: If there is no task of that name that has a frame.
        """
        found = np.eye(4)
        found[:3, 3], found[:3, :3] = self._frames.pose(name, self._q)
        return found

    def jacobian(self, name: str) -> Array:
        """Return J (6, nv) of a task's frame, [linear; angular] in the world's axes, as `pose`.

        Raises:
            ModelError: If there is no task of that name that has a frame.
        """
        return self._frames.jacobian(name, self._q)

    def command(self, v: Array, q: ArrayLike | None = None, dt: float | None = None) -> Step:
        """Return a step that carries out a velocity of the caller's own (nv,) inside the limits.

        It is clipped into the box, and shortened where a distance would be passed.
        The program is not solved; the errors are those of the targets at q.
        """
        self._begin()
        valid = self._q.copy() if q is None else self._configurations.read(q)
        if valid is None:
            return self._refuse(None, self._configurations.fault("q", q))
        if not np.isfinite(v).all():
            return self._refuse(None, self._configurations.velocity_fault("v", v))
        seconds = self.problem.dt if dt is None else seconds_of(dt)
        if seconds is None:
            return self._refuse(None, _no_time(dt))
        engine, dofs, dt = self.engine, self.problem.dofs, seconds
        outside = engine.prepare(valid, self._v, dt)
        qp = engine.assembly.qp
        solution = Solution.at_rest(qp, SolveStatus.SOLVED)
        solution.v = np.clip(v[dofs], qp.lb, qp.ub)
        solution.kkt = UNCERTIFIED
        engine.keep_distances(solution, dt)
        flags = _RECOVERING if outside else 0
        if engine.relaxed:
            flags |= _RELAXED
        if np.abs(solution.v - v[dofs]).max() > 0.0:
            flags |= _LIMITED
        return self._carried_out(valid, solution, flags, dt, self._v.copy())

    def _flags(self, solution: Solution) -> int:
        """Return the statuses that hold, bit k for the status of value k."""
        flags = 0
        if self._refused:
            flags |= _INVALID_INPUT
        engine = self.engine
        if not engine.evaluation.refused and solution.status is not _SOLVED:
            flags |= _DEADLINE if solution.status is SolveStatus.TIME_LIMIT else _MAX_ITER
        if self._budget < math.inf and perf_counter() > engine.deadline:
            flags |= _DEADLINE
        if engine.scaled:
            flags |= _SCALED
        if engine.outside:
            flags |= _RECOVERING
        if engine.relaxed:
            flags |= _RELAXED
        if self._adapts and engine.damped:
            flags |= _DAMPED
        if self._progress.stuck:
            flags |= _STUCK
        z = solution.bound_multiplier
        if self._frozen is not None:
            z = np.where(self._frozen, 0.0, z)  # a frozen joint is no limit that is in the way
        y = solution.row_multiplier
        if z.dot(z) + y.dot(y) > ACTIVE_MULTIPLIER**2 or engine.share < 1.0 or engine.passes:
            flags |= _LIMITED
        return flags

    def _refuse(self, dt: float | None, what: str) -> Step:
        """Return a brake in place of a step for which an argument is not valid."""
        self._refused += (f"{what}; the robot brakes",)
        return self._brake(dt, _INVALID_INPUT)

    def _brake(self, dt: float | None, flags: int) -> Step:
        """Return a step that slows down at the acceleration limit, or stands still at once.

        Nothing of the controller changes but what it has commanded.
        """
        if self._refused:
            flags |= _INVALID_INPUT
        seconds = dt or self.problem.dt
        dofs, box, v = self.problem.dofs, self.problem.box, np.zeros(self._model.nv)
        before = self._v[dofs]
        # What is faster than it may be sheds all that it can, not only its part.
        most = np.maximum(box.velocity, np.abs(before) - box.acceleration * seconds)
        v[dofs] = np.clip(braked(box, before, seconds, self._q), -most, most)
        solution = Solution.at_rest(self.engine.assembly.qp)
        solution.v = v[dofs]
        self._progress.reset()
        self.engine.share = 1.0  # of a brake nothing was left out
        return self._carried_out(self._q.copy(), solution, flags, seconds, self._v.copy())

    def __repr__(self) -> str:
        return f"Controller({self.problem!r}, engine={self.engine.name!r})"


def _no_time(dt: object) -> str:
    return f"dt is {told(dt)}, and no time of {SHORTEST:g} to {LONGEST:g} s"
