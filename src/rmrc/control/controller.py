"""`Controller`: one certified joint velocity a step, whatever comes in."""

from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmrc.control.engine import PythonEngine
from rmrc.control.inputs import Configurations, Targets
from rmrc.control.methods import UNCERTIFIED, ClosedFormEngine
from rmrc.control.step import Errors, Status, Step
from rmrc.errors import ModelError, unknown_name
from rmrc.problem.problem import Problem
from rmrc.qp.program import Solution, SolveStatus

Array = NDArray[np.float64]

SHORTEST, LONGEST = 1e-9, 1e3
"""Lengths of a step in s beyond which a clock, not a robot, is at fault."""
ACTIVE_MULTIPLIER = 1e-7
"""A limit is active where its multiplier is above this, in the program's unit."""

_LIMITED = 1 << Status.LIMITED
_SCALED = 1 << Status.SCALED
_RELAXED = 1 << Status.RELAXED
_RECOVERING = 1 << Status.RECOVERING
_MAX_ITER = 1 << Status.MAX_ITER
_INVALID_INPUT = 1 << Status.INVALID_INPUT


class Controller:
    """Solves a problem step by step, for a control loop at 100 to 1000 Hz.

    `step` and `set_target` never raise for what a caller can meet at run time; they answer with a
    `Status`. Only a name that does not exist raises.
    """

    def __init__(self, problem: Problem, engine: Literal["auto", "python"] = "auto"):
        if engine not in ("auto", "python"):
            raise ModelError(unknown_name("engine", engine, ("auto", "python")))
        self.problem = problem
        closed_form = problem.config.method != "qp"
        self.engine = ClosedFormEngine(problem) if closed_form else PythonEngine(problem)
        model = problem.model
        self._model, self._evaluation = model, self.engine.evaluation
        self._all = problem.dofs.size == model.nv
        self._configurations = Configurations(model)
        self._targets = Targets(self._evaluation, self._configurations)
        frozen = problem.box.velocity == 0.0
        self._frozen = frozen if frozen.any() else None
        self._refused = False
        self._term = dict(problem.term)
        self._q = problem.start.copy()
        self._v = np.zeros(model.nv)
        self.reset()

    def reset(self, q: ArrayLike | None = None) -> None:
        """Start from rest at q (nq,), by default the start of the config; targets return to theirs.

        Raises:
            ModelError: If q is not a configuration of this model.
        """
        evaluation = self._evaluation
        if q is not None:
            valid = self._configurations.read(q)
            if valid is None:
                raise ModelError(
                    f"q must be {self._configurations.size} finite numbers with no zero quaternion"
                )
            self._q = valid
        else:
            self._q = self.problem.start.copy()
        self._v[:] = 0.0
        self._refused = False
        for term in self.problem.terms:
            evaluation.target[term.name][:] = term.target
            evaluation.stop(term.name)
        self.engine.reset()

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
        accepted = self._targets.take(term, position, quaternion, velocity, q, direction)
        if not accepted:
            self._refused = True
        return accepted

    def step(self, q: ArrayLike | None = None, dt: float | None = None) -> Step:
        """Return the command for the next step of dt seconds.

        Args:
            q: Measured configuration (nq,); by default the one that the last command led to.
            dt: Length of the step, s; by default the problem's.
        """
        valid = self._q if q is None else self._configurations.read(q)
        seconds = self.problem.dt if dt is None else self._seconds(dt)
        if valid is None or seconds is None:
            return self._brake(dt)
        dt = seconds
        solution = self.engine.solve(valid, self._v, dt)
        return self._carried_out(valid, solution, self._flags(solution), dt)

    def _carried_out(self, q: Array, solution: Solution, flags: int, dt: float) -> Step:
        """Integrate a solution over dt from q, and remember where it leads."""
        if self._all:
            v = solution.v
        else:
            v = np.zeros(self._model.nv)
            v[self.problem.dofs] = solution.v
        following = q.copy()
        mujoco.mj_integratePos(self._model, following, v, dt)
        self._q[:] = following
        self._v[:] = v
        evaluation = self._evaluation
        return Step(v, following, flags, Errors(evaluation, evaluation.error.copy()), solution)

    @property
    def q(self) -> Array:
        """The configuration (nq,) that the last command led to."""
        return self._q.copy()

    def command(self, v: Array, q: ArrayLike | None = None) -> Step:
        """Return a step that carries out a velocity of the caller's own (nv,), inside the box.

        The program is not solved; the errors are those of the targets at q.
        """
        valid = self._q if q is None else self._configurations.read(q)
        if valid is None or not np.isfinite(v).all():
            return self._brake(None)
        engine, dofs, dt = self.engine, self.problem.dofs, self.problem.dt
        outside = engine.prepare(valid, self._v, dt)
        qp = engine.assembly.qp
        solution = Solution.at_rest(qp, SolveStatus.SOLVED)
        solution.v = np.clip(v[dofs], qp.lb, qp.ub)
        solution.kkt = UNCERTIFIED
        flags = _RECOVERING if outside else 0
        if np.abs(solution.v - v[dofs]).max() > 0.0:
            flags |= _LIMITED
        return self._carried_out(valid, solution, flags, dt)

    def _flags(self, solution: Solution) -> int:
        """Return the statuses that hold, bit k for the status of value k."""
        flags = 0
        if self._refused:
            self._refused = False
            flags |= _INVALID_INPUT
        if solution.status is not SolveStatus.SOLVED:
            flags |= _MAX_ITER
        if self.engine.scaled:
            flags |= _SCALED
        if self.engine.outside:
            flags |= _RECOVERING
        if self.engine.relaxed:
            flags |= _RELAXED
        z = solution.bound_multiplier if self._frozen is None else solution.bound_multiplier.copy()
        if self._frozen is not None:
            z[self._frozen] = 0.0  # a frozen joint is no limit that is in the way
        y = solution.row_multiplier
        if z.dot(z) + y.dot(y) > ACTIVE_MULTIPLIER**2:
            flags |= _LIMITED
        return flags

    def _brake(self, dt: object) -> Step:
        """Return a step that slows down at the acceleration limit, or stands still at once.

        Nothing of the controller changes but the velocity that it has commanded.
        """
        self._refused = False
        seconds = self._seconds(dt) or self.problem.dt
        change = np.full(self._model.nv, np.inf)
        change[self.problem.dofs] = self.problem.box.acceleration * seconds
        v = self._v - np.clip(self._v, -change, change)
        q = self._q.copy()
        mujoco.mj_integratePos(self._model, q, v, seconds)
        self._v[:] = v
        solution = Solution.at_rest(self.engine.assembly.qp)
        solution.v = v[self.problem.dofs]
        evaluation = self._evaluation
        error = evaluation.error.copy()
        return Step(v, q, _INVALID_INPUT, Errors(evaluation, error), solution)

    def _seconds(self, dt: object) -> float | None:
        """Return a length of a step in s, or None if it is none."""
        try:
            seconds = float(dt)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            return None
        return seconds if SHORTEST <= seconds <= LONGEST else None
