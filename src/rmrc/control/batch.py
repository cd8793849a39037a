"""`BatchController`: many independent controllers of one problem, a step of all at once."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmrc.control.controller import FAILED, Controller, seconds_of
from rmrc.control.engines import Choice
from rmrc.control.inputs import Configurations, numbers
from rmrc.control.status import Status
from rmrc.errors import ModelError, RmrcError
from rmrc.problem.problem import Problem

Array = NDArray[np.float64]
Flags = NDArray[np.int32]
Rows = tuple[Array, Array, Flags]

_MOST_SEVERE = np.array([max(bits.bit_length() - 1, 0) for bits in range(2 << max(Status))])
_PARTS = (
    "Python takes a part of each step, as with timeouts, a measured velocity, a lag or a jerk limit"
)


@dataclass(frozen=True, eq=False, slots=True)
class BatchStep:
    """One control step of n elements, by rows."""

    v: Array
    """Joint velocities to command (n, nv), rad/s or m/s; always finite and inside the box."""
    q: Array
    """Configurations (n, nq) that v leads to in one step."""
    flags: Flags
    """The statuses that hold (n,), bit k for the `Status` of value k."""

    @property
    def status(self) -> NDArray[np.int64]:
        """The most severe of the statuses that hold (n,), as values of `Status`."""
        return _MOST_SEVERE[self.flags]


class BatchController:
    """Solves n copies of a problem step by step, each with its own state and targets.

    An element takes the same steps, bit by bit, as a `Controller` with the same engine that is
    given the same; neither the others nor the number of threads make a difference. The native
    engine shares the elements out among threads, without the GIL. Where Python takes a part of
    every step (see `notices`) there are n controllers, and one is stepped after the other.

    As with a controller `step` and `set_targets` never raise for what a caller can meet at run
    time, and calls must not overlap. Obstacles stay where the model has them.
    """

    def __init__(
        self, problem: Problem, n: int, threads: int | None = None, engine: Choice = "auto"
    ):
        """Allocate for n elements.

        Args:
            problem: What each of them solves.
            n: Number of elements.
            threads: Number of threads that take steps, the calling one included; by default as
                many as there are processors for this process.
            engine: As of a `Controller`.

        Raises:
            ModelError: If n or threads is below 1, or there is no engine of that name.
            ConfigError: If the native engine is asked for by name and cannot run the problem.
        """
        for name, count in (("n", n), ("threads", threads)):
            if count is not None and count < 1:
                raise ModelError(f"{name} must be at least 1, not {count}")
        self.problem, self.n = problem, n
        self._configurations = Configurations(problem.model)
        first = Controller(problem, engine)
        self.notices = first.notices
        self.engine = first.engine.name
        """Name of the engine."""
        self.threads = 1
        """Number of threads that take steps."""
        if first.stepper is None:
            self._elements = _OneByOne(problem, n, engine)
            reason = _PARTS if self.engine == "native" else "only the native engine has threads"
            self.notices += (f"{n} controllers are stepped one after the other: {reason}",)
        else:
            from rmrc.control.fast.batch import NativeBatch  # which is there if its engine is

            self.threads = min(n, threads or _processors())
            others = [Controller(problem, engine) for _ in range(self.threads - 1)]
            self._elements = NativeBatch(problem, [first, *others], n)
        self.failures = np.zeros(n, dtype=np.int64)
        """Steps in a row (n,), up to the last, that ended without a certified solution."""
        self.reset()

    def __reduce__(self) -> NoReturn:
        raise RmrcError(
            "a BatchController cannot be copied or pickled: it holds the memory of a solver. "
            "Make another with BatchController(problem, n) and `reset` it to the same q and v"
        )

    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> None:
        """Start all elements anew; targets return to those of the configuration.

        Args:
            q: Configurations (n, nq), or one (nq,) for all; by default the start of the config.
            v: Velocities (n, nv) that the robots move with, or one (nv,); by default they rest.

        Raises:
            ModelError: If q or v does not fit this model and n.
        """
        read, model = self._configurations, self.problem.model
        start = self._rows("q", self.problem.start if q is None else q, model.nq, read.read)
        rates = np.zeros(model.nv) if v is None else v
        self._elements.reset(start, self._rows("v", rates, model.nv, read.read_velocity))
        self.failures[:] = 0

    def _rows(
        self, name: str, given: ArrayLike, width: int, read: Callable[[object], Array | None]
    ) -> Array:
        """Return valid rows (n, width) of what is given for each element, or once for all."""
        array = numbers(given, self.n, width)
        rows = [read(row) for row in array] if array is not None else [read(given)] * self.n
        valid = [row for row in rows if row is not None]
        if len(valid) < self.n:
            shape = f"({self.n}, {width}) or ({width},)"
            raise ModelError(f"{name} must be {shape}: finite numbers with no zero quaternion")
        return np.array(valid)

    def set_targets(
        self, name: str, targets: ArrayLike, velocities: ArrayLike | None = None
    ) -> NDArray[np.bool_]:
        """Set a task's target of all elements; return (n,) whose were valid.

        An element whose row is not valid keeps its last good one, and its next step says
        `INVALID_INPUT`.

        Args:
            name: The task.
            targets: Poses (n, 7), xyz in m and wxyz of any norm but zero, or points (n, 3), in the
                world or in the root's coordinates.
            velocities: The targets' own velocities as feed-forward: of poses (n, 6), linear then
                angular, m/s and rad/s; of points (n, 3), m/s; by default they rest.

        Raises:
            ModelError: If there is no such task, or its target is neither a pose nor a point.
        """
        kind = self.problem.named(name).target_kind
        if kind not in ("pose", "point"):
            raise ModelError(f"task '{name}' has no target that is a pose or a point")
        width, rates = (7, 6) if kind == "pose" else (3, 3)
        values = numbers(targets, self.n, width)
        twists = None if velocities is None else numbers(velocities, self.n, rates)
        if values is None or (velocities is not None and twists is None):
            values = np.full((self.n, width), np.nan)  # which no element takes
        return self._elements.set_targets(name, values, twists)

    def step(self, q: ArrayLike | None = None, dt: float | None = None) -> BatchStep:
        """Return the commands for the next step of dt seconds.

        An element whose q is not valid brakes from where its last command led to.

        Args:
            q: Measured configurations (n, nq); by default those that the last commands led to.
            dt: Length of the step, s; by default the problem's.
        """
        seconds = self.problem.dt if dt is None else seconds_of(dt)
        given = None if q is None else numbers(q, self.n, self.problem.model.nq)
        if seconds is None or (q is not None and given is None):
            # With this all elements brake.
            given = np.full((self.n, self.problem.model.nq), np.nan)
        step = BatchStep(*self._elements.step(given, seconds or self.problem.dt))
        failed = step.flags & FAILED
        none = np.zeros_like(self.failures)
        self.failures = np.where(failed, self.failures + 1, none) if failed.any() else none
        return step

    @property
    def q(self) -> Array:
        """The configurations (n, nq) that the last commands led to."""
        return self._elements.q


class _OneByOne:
    """Takes the steps of `count` elements with as many controllers."""

    def __init__(self, problem: Problem, count: int, engine: Choice):
        self._controllers = [Controller(problem, engine) for _ in range(count)]

    def reset(self, q: Array, v: Array) -> None:
        """Start anew at valid q (n, nq) with v (n, nv)."""
        for controller, *state in zip(self._controllers, q, v, strict=True):
            controller.reset(*state)

    def set_targets(self, name: str, values: Array, velocities: Array | None) -> NDArray[np.bool_]:
        """Set a target of all elements, and return whose was valid."""
        rates = [None] * len(values) if velocities is None else velocities
        return np.array(
            [
                controller.set_target(name, row[:3], row[3:] if row.size > 3 else None, rate)
                for controller, row, rate in zip(self._controllers, values, rates, strict=True)
            ]
        )

    @property
    def q(self) -> Array:
        """The configurations (n, nq) that the last commands led to."""
        return np.array([controller.q for controller in self._controllers])

    def step(self, q: Array | None, dt: float) -> Rows:
        """Return v, q and flags after a step of dt seconds from q (n, nq), or the last's."""
        given = [None] * len(self._controllers) if q is None else q
        steps = [
            controller.step(row, dt)
            for controller, row in zip(self._controllers, given, strict=True)
        ]
        flags = np.array([step.flag_bits for step in steps], dtype=np.int32)
        return np.array([step.v for step in steps]), np.array([step.q for step in steps]), flags


def _processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
