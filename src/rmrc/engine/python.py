"""The Python engine: evaluate, assemble, solve, certify, and what there is where that fails."""

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from rmrc.config.solvers import DEFAULT, backend_of
from rmrc.engine.backtracking import Shortening
from rmrc.engine.correction import raise_rows
from rmrc.limits.box import braked
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.qp.backends import HEALTHY, Backend, create
from rmrc.qp.cascade import WHOLE, Cascade
from rmrc.qp.certificate import Certificate
from rmrc.qp.equalities import Held
from rmrc.qp.program import QP, Solution, SolveStatus
from rmrc.qp.relax import INCONSISTENT, least_violation
from rmrc.qp.rows import Rows

Array = NDArray[np.float64]

CERTIFIED = 1e-6
"""Largest KKT residual of a solution that is trusted: of limits in rad/s or m/s, of the others
relative to the largest of 1 and ‖g‖, in the program's unit."""
PROXIMAL = 20
"""Outer iterations of ProxQP in place of another backend: nine of ten programs that it solves take
fewer than 15, and one that it does not may take a second by its hundredth."""
GAINED = 1e-3
"""Share of the command that solving again has to gain: less is what distances jump by."""
MORE_ROOM = 1e-8
"""What relaxed rows are given besides where nothing solves their program, rad/s or m/s."""
FORCED = 1e-9
"""Rate by which a brake exceeds that of the joints alone, rad/s or m/s: more than rounding."""
MOST_SHAPES = 256
"""Numbers of rows for which a backend is kept."""

_SOLVED = SolveStatus.SOLVED  # to look it up takes 0.1 µs


@dataclass(eq=False)
class _Solver:
    """A backend with the program it is set up for."""

    qp: QP
    backend: Backend
    certificate: Certificate
    ready: bool = False
    """Whether the backend can start from its last solution."""
    warm: bool = False
    """Whether the last solve did so."""


class PythonEngine:
    """Turns q, v_prev, the targets and dt into a certified `Solution`.

    This engine is the specification; any other must give the same results.
    """

    name = "python"
    fault: str | None = None
    """What ends a run: nothing does."""
    passes = False
    """Whether a command passes a limit of a joint: none does."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.backend = backend_of(problem.config.solver.backend)
        """What solves the programs."""
        self.evaluation = Evaluation(problem)
        self._assembly = Assembly(problem, self.evaluation)
        self._rows = self._new_rows()
        self._shortening = self._new_shortening() if problem.barriers else None
        self._solvers: dict[tuple[int, int, bool], _Solver] = {}
        self._solver = self._solver_of(self._assembly.qp)
        hard = any(term.hard for term in self.evaluation.terms)
        self._dt = problem.dt
        """Length of the present step, s."""
        self._box_alone = not (self._rows.any or hard)
        self._cuts = False
        """Whether planes may be added to the present program, as nothing of it was relaxed."""
        self._cascade = Cascade(problem.dofs.size, self._new_backend) if problem.cascaded else None
        self.deadline = math.inf
        """When the step must be done, on the clock of `perf_counter`, s."""
        self.outside = False
        """Whether a joint or a distance was outside its limit at the last step."""
        self.relaxed = False
        """Whether rows or equalities of the last step could not hold, and were given slack."""
        self.scaled = False
        """Whether a task that preserves its direction ran slower than asked at the last step."""
        self.share = 1.0
        """What the check at the next configuration left of the last command, from the brake on."""

    def _new_rows(self) -> Rows:
        return Rows(self.problem, self.evaluation)

    def _new_shortening(self) -> Shortening:
        return Shortening(self.problem, self.evaluation.obstacle_twist)

    def _new_backend(self) -> Backend:
        solver = self.problem.config.solver
        return create(self.backend, max_iter=solver.max_iter, tolerance=solver.tolerance)

    def _other_backend(self) -> Backend:
        """Return one of another kind: a dual method for a primal one, and the other way round."""
        solver = self.problem.config.solver
        if self.backend != DEFAULT:
            return create(DEFAULT, max_iter=solver.max_iter)
        return create("proxqp", max_iter=min(solver.max_iter or PROXIMAL, PROXIMAL))

    def _solver_of(self, qp: QP, other: bool = False) -> _Solver:
        """Return what solves programs of this shape: the backend that was chosen, or another."""
        key = (qp.lo.size, qp.f.size, other)
        if key not in self._solvers:
            if len(self._solvers) >= MOST_SHAPES:
                self._solvers.clear()
            backend = self._other_backend() if other else self._new_backend()
            self._solvers[key] = _Solver(qp, backend, Certificate(qp))
        return self._solvers[key]

    @property
    def assembly(self) -> Assembly:
        """The program of the last step."""
        return self._assembly

    @property
    def rows(self) -> Rows:
        """The rows of the last step."""
        return self._rows

    @property
    def damped(self) -> bool:
        """Whether the damping of the last step was above its floor."""
        return self._assembly.damped

    @property
    def steps_alone(self) -> bool:
        """Whether the extension can take a controller's common steps without Python."""
        return False

    def reset(self) -> None:
        """Forget the last solution, so that the next solve starts cold."""
        for solver in self._solvers.values():
            solver.ready = False
        for barrier in self._rows.barriers:
            barrier.forget()

    def solve(self, q: Array, v_previous: Array, dt: float) -> Solution:
        """Return the solution at q (nq,) for a step of dt seconds, the best that the ladder has.

        The rungs: the full program; the same from a cold start; the same by another backend; the
        least violation of rows and equalities, and the optimum within it; that point; the box
        alone; a brake,
        which is the point of the box nearest to rest. Where distances would be passed at the end of
        the step, it is solved again for the curvature of the step, or shortened. When the time is
        over, a step ends with the point that it has if all limits are known to hold there, else
        with the brake.
        """
        self.outside = self.prepare(q, v_previous, dt)
        self.scaled = False
        if self.evaluation.refused:
            return self._held_back(dt)
        solution, assembly = self._certified(), self._assembly
        while self._cuts and self._in_time() and self._cut(solution):
            solution = self._certified()
        self._slow_down(solution)
        if assembly.yielding.softened:
            self.relaxed |= assembly.yielding.misses(solution.v) > INCONSISTENT
        if self._shortening is not None and self._rows.blocks:
            solution = self._at_distance(solution, dt)
        else:
            self.share = 1.0
        self._rows.straighten(assembly.qp)
        return solution

    def _certified(self) -> Solution:
        """Return the optimum of the program, or what the ladder has in place of it."""
        solution = self._best()
        return solution if self._trusted(solution) else self._descend_ladder(solution)

    def _cut(self, solution: Solution) -> bool:
        """Change the program where its solution moves frames too fast; return whether it was.

        The programs of a cascade have no cost in common that the curvature could be added to.
        """
        y = solution.row_multiplier if self._cascade is None else None
        return self._rows.cut(self._assembly.qp, solution.v, y)

    def _slow_down(self, solution: Solution) -> None:
        """Have no frame faster than it may be, where a solution was not found by planes alone."""
        rows = self._rows
        if not rows.speed_count or rows.excess(solution.v) <= 0.0:
            return
        solution.v = rows.slowed(self._brake(), solution.v)
        self.relaxed |= self._misses(solution.v)

    def _held_back(self, dt: float) -> Solution:
        """Return the brake, for a step of which a part cannot be used; it keeps distances."""
        solution = self._stop(Solution.at_rest(self._assembly.qp))
        self.keep_distances(solution, dt)
        return solution

    def prepare(self, q: Array, v_previous: Array, dt: float) -> bool:
        """Evaluate and assemble without solving.

        Return whether a joint is outside its range, or a distance below its limit.
        """
        assembly = self._assembly
        self._dt = assembly.yielding.dt = dt
        self.evaluation.v_previous[:] = v_previous
        outside = self._assemble(q, dt)
        if self._box_alone:
            return outside
        equalities = None if self.evaluation.refused else assembly.equalities()
        self.relaxed = equalities is not None and equalities.inconsistency > INCONSISTENT
        self._rows.update(assembly.qp, assembly.rate, dt)
        self._cuts = True
        self._take_rows(equalities)
        return outside or self._rows.passed

    def _take_rows(self, equalities: Held | None = None) -> None:
        """Write the rows, and equalities if there are any, into the program."""
        assembly, rows = self._assembly, self._rows
        count = 0 if equalities is None else equalities.right.size
        if (rows.count, count) != (assembly.qp.lo.size, assembly.qp.f.size):
            assembly.resize(rows.count, count)
        qp = assembly.qp
        if rows.count:
            qp.C[:], qp.lo[:], qp.hi[:] = rows.matrix, rows.lower, rows.upper
        if equalities is not None:
            qp.E[:], qp.f[:] = equalities.matrix, equalities.right
        self._solver = self._solver_of(qp)

    def _assemble(self, q: Array, dt: float) -> bool:
        """Evaluate the terms and write the cost and the box; return whether a joint is outside."""
        self.evaluation.update(q)
        self.evaluation.evaluate()
        if self.evaluation.refused:
            self._assembly.rate[:] = 0.0
            return self._assembly.assemble_box(q, dt)
        return self._assembly.assemble(q, dt)

    def _descend_ladder(self, failed: Solution) -> Solution:
        """Return the solution of the first rung that holds, from a cold start on."""
        solution, qp = self._elsewhere(self._from_cold(failed)), self._assembly.qp
        if self._trusted(solution):
            return solution
        self._cuts = False
        if not (qp.lo.size or qp.f.size):
            return solution if self._feasible(solution) else self._stop(solution)
        if not self._feasible(solution) and self._in_time():
            found = least_violation(qp, self._brake(), self._allow)
            if found is not None:
                violation, v = found
                self.relaxed |= violation > INCONSISTENT
                solution = self._within_relaxed(v)
        if self._trusted(solution) or self._feasible(solution):
            return solution
        if self._in_time():
            self.relaxed = True
            solution = self._without_rows(qp)
            if self._trusted(solution) or self._feasible(solution):
                return solution
        return self._stop(solution)

    def _within_relaxed(self, v: Array) -> Solution:
        """Return the optimum of what was relaxed for v (n,), or that point if it is not found."""
        qp, solution = self._assembly.qp, Solution.at_rest(self._assembly.qp)
        for room in (0.0, MORE_ROOM):
            qp.lo -= room
            qp.hi += room
            solution = self._elsewhere(self._best(), feasible=True)
            if self._trusted(solution) or self._feasible(solution) or not self._in_time():
                break
        if self._trusted(solution) or self._feasible(solution):
            return solution
        timed_out = solution.status is SolveStatus.TIME_LIMIT
        status = SolveStatus.TIME_LIMIT if timed_out else SolveStatus.MAX_ITER
        point = Solution.at_rest(qp, status)
        point.v[:] = v
        Certificate(qp).certify(point)
        return point

    def _best(self) -> Solution:
        """Return the optimum of the program, from a warm start where there is one."""
        if self._cascade is None:
            return self._attempt(self._solver)
        self._cascade.deadline = self.deadline
        assembly, cascade = self._assembly, self._cascade
        levels = assembly.levels()
        solution = cascade.solve(levels, assembly.qp)
        if assembly.yielding.turns_back(cascade.directed):
            levels = assembly.levels(directed=False)
            solution = cascade.solve(levels, assembly.qp)
        if assembly.yielding.still and self.problem.curvature:
            solution.v = assembly.yielding.spare(levels, cascade.optima)
        self.scaled = cascade.scale < 1.0 - WHOLE
        return solution

    def _from_cold(self, solution: Solution) -> Solution:
        """Return the optimum from a cold start, where a warm one led to another point."""
        solver = self._solver
        again = self._cascade is None and solver.warm and not self._trusted(solution)
        if not again or not self._in_time():
            return solution
        solver.ready = False
        return self._attempt(solver)

    def _elsewhere(self, solution: Solution, feasible: bool = False) -> Solution:
        """Return the optimum as another backend finds it, where this one gives up on its own.

        A program that is known to be feasible it gives up on even where it says the contrary.
        """
        refused = solution.status is SolveStatus.INFEASIBLE and not feasible
        if refused or self._trusted(solution) or self._cascade is not None or not self._in_time():
            return solution
        other = self._solver_of(self._assembly.qp, other=True)
        other.ready = False
        found = self._attempt(other)
        return found if self._trusted(found) else solution

    def _attempt(self, solver: _Solver) -> Solution:
        self._allow(solver.backend)
        solver.warm = solver.ready
        if solver.warm:
            solver.backend.update(solver.qp)
        else:
            solver.backend.setup(solver.qp)
        solution = solver.backend.solve()
        solver.certificate.certify(solution)
        # What ran out of time goes on from where it got to.
        solver.ready = solution.status in HEALTHY
        return solution

    def _allow(self, backend: Backend) -> bool:
        """Give a backend the time that is left, and return whether there is any."""
        if self.deadline < math.inf:
            backend.allow(self.deadline - perf_counter())
        return self._in_time()

    def _in_time(self) -> bool:
        return self.deadline == math.inf or perf_counter() < self.deadline

    def _trusted(self, solution: Solution) -> bool:
        if solution.status is not _SOLVED:
            return False
        primal, dual, complementarity = solution.kkt
        if primal > CERTIFIED:
            return False
        largest, g = max(dual, complementarity), self._assembly.qp.g
        return largest <= CERTIFIED or largest <= CERTIFIED * math.sqrt(g.dot(g))

    @staticmethod
    def _feasible(solution: Solution) -> bool:
        """Return whether a solver that was interrupted has left a point that keeps all limits."""
        stopped = solution.status in (SolveStatus.MAX_ITER, SolveStatus.TIME_LIMIT)
        return stopped and solution.kkt.primal <= CERTIFIED

    def _without_rows(self, qp: QP) -> Solution:
        """Return the optimum inside the box alone."""
        self._assembly.resize(0, 0)
        self._solver = self._solver_of(self._assembly.qp)
        solution = self._attempt(self._solver)
        solution.row_multiplier = np.zeros(qp.lo.size)
        solution.equality_multiplier = np.zeros(qp.f.size)
        return solution

    def _stop(self, failed: Solution) -> Solution:
        """Return the brake in place of a solution that is none."""
        failed.v = self._brake()
        if failed.status is SolveStatus.SOLVED:
            failed.status = SolveStatus.FAILED
        return failed

    def _brake(self) -> Array:
        """Return the point of the box nearest to the next one on the way to rest."""
        qp = self._assembly.qp
        v = np.clip(self._planned(), qp.lb, qp.ub)
        return v if np.isfinite(v).all() else np.zeros(qp.g.size)

    def _planned(self) -> Array:
        """Return what braking as the step before has looked at it leaves of the velocity (n,)."""
        evaluation = self.evaluation
        before = evaluation.v_previous[self.problem.dofs]
        return braked(self.problem.box, before, self._dt, evaluation.data.qpos)

    def keep_distances(self, solution: Solution, dt: float) -> None:
        """Shorten v towards the brake where a distance would be passed at the end of the step."""
        self.share = 1.0
        if self._shortening is None or not self._rows.blocks:
            return
        evaluation, brake = self.evaluation, self._brake()
        self._shortening.deadline = self.deadline
        self.share, passed = self._shortening.share(
            evaluation.data, solution.v, brake, self._rows.blocks, dt
        )
        if self.share < 1.0:
            solution.v = brake + self.share * (solution.v - brake)
            passed = passed or self._misses(solution.v)
        if self.share == 0.0 and not self._in_time():
            passed = passed or self._is_forced(brake)
        self.relaxed |= passed

    def _is_forced(self, brake: Array) -> bool:
        """Return whether the brake goes on otherwise than the joints would stop by themselves.

        So it does where they come back into their ranges: its way to rest is then not what the step
        before has looked at.
        """
        faster = np.abs(brake) > np.abs(self._planned()) + FORCED
        return bool(faster[np.isfinite(self.problem.box.acceleration)].any())

    def _misses(self, v: Array) -> bool:
        """Return whether a shortened command misses equalities, or rows that are no distances'.

        Of the speed of a frame its norm counts, not the planes that stand for it.
        """
        qp, rows = self._assembly.qp, self._rows
        if qp.f.size and np.abs(qp.E @ v - qp.f).max() > CERTIFIED:
            return True
        if qp.lo.size != rows.count:
            return False
        activity = qp.C @ v
        missed = np.maximum(qp.lo - activity, activity - qp.hi)
        for block in rows.blocks + rows.kept_blocks:
            missed[block.rows] = 0.0
        missed[: rows.speed_count] = 0.0
        return max(missed.max(initial=0.0), rows.excess(v)) > CERTIFIED

    def _at_distance(self, solution: Solution, dt: float) -> Solution:
        """Return a solution that keeps distances: solved again for the curvature, or shortened."""
        whole, relaxed = solution.v, self.relaxed
        self.keep_distances(solution, dt)
        qp, evaluation = self._assembly.qp, self.evaluation
        untouched = self.share == 1.0 or qp.lo.size != self._rows.count
        if self._shortening is None or untouched or not self._in_time():
            return solution
        ends = self._shortening.ends(evaluation.data, whole, dt)
        if not raise_rows(qp, self._rows.blocks, ends, self.problem.resolution):
            return solution
        corrected = self._best()
        while self._trusted(corrected) and self._cut(corrected):
            corrected = self._best()
        if not self._trusted(corrected) or self._rows.excess(corrected.v) > 0.0:
            return solution
        share, passed = self.share, self.relaxed
        self.relaxed = relaxed
        self.keep_distances(corrected, dt)
        if self.share > share + GAINED:
            return corrected
        self.share, self.relaxed = share, passed
        return solution
