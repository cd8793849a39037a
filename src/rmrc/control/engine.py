"""The Python engine: evaluate, assemble, solve, certify."""

import math

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.qp.backends import Backend, create
from rmrc.qp.cascade import WHOLE, Cascade
from rmrc.qp.certificate import Certificate
from rmrc.qp.program import QP, Solution, SolveStatus

Array = NDArray[np.float64]

CERTIFIED = 1e-6
"""Largest KKT residual of a solution that is trusted: of limits in rad/s or m/s, of the others
relative to the largest of 1 and ‖g‖, in the program's unit."""
SLACK_WEIGHT = 1e6
"""ρ of the slack's cost ½ρt², beside weights of at most 1."""


class PythonEngine:
    """Turns q, v_prev, the targets and dt into a certified `Solution`.

    This engine is the specification; any other must give the same results.
    """

    name = "python"

    def __init__(self, problem: Problem):
        self.problem = problem
        self.evaluation = Evaluation(problem)
        self.assembly = Assembly(problem, self.evaluation)
        self._backend = self._new_backend()
        self._ready = False
        self.outside = False
        """Whether a joint was outside its range at the last step."""
        self.relaxed = False
        """Whether the rows of the last step contradicted the box and were given slack."""
        self._certificate = Certificate(self.assembly.qp)
        directed = any(term.preserve for term in problem.terms)
        self._cascade = (
            Cascade(problem.dofs.size, self._new_backend) if problem.strict or directed else None
        )
        self.scaled = False
        """Whether a task that preserves its direction ran slower than asked at the last step."""

    def _new_backend(self) -> Backend:
        solver = self.problem.config.solver
        return create(solver.backend, max_iter=solver.max_iter, tolerance=solver.tolerance)

    def reset(self) -> None:
        """Forget the last solution, so that the next solve starts cold."""
        self._ready = False

    def solve(self, q: Array, v_previous: Array, dt: float) -> Solution:
        """Return the solution at q (nq,) for a step of dt seconds, the best that the ladder has.

        The rungs: the full program; the same from a cold start; slack on the rows; a brake, which
        is the point of the box nearest to rest.
        """
        assembly = self.assembly
        self.outside = self.prepare(q, v_previous, dt)
        self.relaxed = False
        if self._cascade is not None:
            return self._descend(self._cascade)
        if self.problem.mink_limits:
            self._set_rows(dt)
        solution = self._attempt(assembly.qp)
        if self._trusted(solution):
            return solution
        self._ready = False
        again = self._attempt(assembly.qp)
        if self._trusted(again):
            return again
        self._ready = False
        return self._fall_back(again)

    def prepare(self, q: Array, v_previous: Array, dt: float) -> bool:
        """Evaluate and assemble without solving; return whether a joint is outside its range."""
        evaluation = self.evaluation
        evaluation.v_previous[:] = v_previous
        evaluation.update(q)
        evaluation.evaluate()
        return self.assembly.assemble(q, dt)

    def _descend(self, cascade: Cascade) -> Solution:
        """Return the lexicographic optimum, or the brake."""
        qp = self.assembly.qp
        solution = cascade.solve(self.assembly.levels(), qp.lb, qp.ub)
        self.scaled = cascade.scale < 1.0 - WHOLE
        return solution if self._trusted(solution) else self._fall_back(solution)

    def _attempt(self, qp: QP) -> Solution:
        if self._ready:
            self._backend.update(qp)
        else:
            self._backend.setup(qp)
            self._ready = True
        solution = self._backend.solve()
        self._certificate.certify(solution)
        return solution

    def _trusted(self, solution: Solution) -> bool:
        if solution.status is not SolveStatus.SOLVED:
            return False
        primal, dual, complementarity = solution.kkt
        if primal > CERTIFIED:
            return False
        largest, g = max(dual, complementarity), self.assembly.qp.g
        return largest <= CERTIFIED or largest <= CERTIFIED * math.sqrt(g.dot(g))

    def _fall_back(self, failed: Solution) -> Solution:
        """Return a feasible point: with slack where the rows contradict the box, else a brake."""
        qp = self.assembly.qp
        if qp.C.shape[0]:
            solution = self._with_slack(qp)
            if self._trusted(solution):
                self.relaxed = True
                return solution
        elif failed.status is SolveStatus.MAX_ITER and failed.v.any():
            return failed  # the certificate has clipped it into the box
        failed.v = np.clip(np.zeros(qp.g.size), qp.lb, qp.ub)
        if not np.isfinite(failed.v).all():
            failed.v = np.zeros(qp.g.size)
        if failed.status is SolveStatus.SOLVED:
            failed.status = SolveStatus.FAILED
        return failed

    def _with_slack(self, qp: QP) -> Solution:
        """Return the optimum with one slack t ≥ 0 on all rows, C v ≤ hi + t, at the cost ½ρt²."""
        n, rows = qp.g.size, qp.hi.size
        soft = QP(n + 1, rows=rows)
        soft.H[:n, :n], soft.H[n, n], soft.g[:n] = qp.H, SLACK_WEIGHT, qp.g
        soft.lb[:n], soft.ub[:n], soft.lb[n] = qp.lb, qp.ub, 0.0
        soft.C[:, :n], soft.C[:, n], soft.hi[:] = qp.C, -1.0, qp.hi
        solver = create("daqp")
        solver.setup(soft)
        solution = solver.solve()
        Certificate(soft).certify(solution)
        solution.v, solution.bound_multiplier = solution.v[:n], solution.bound_multiplier[:n]
        return solution

    def _set_rows(self, dt: float) -> None:
        """Take over the rows of mink's limits; their number may change from step to step."""
        rows = self.assembly.mink_rows(dt)
        count = 0 if rows is None else rows[1].size
        if count != self.assembly.qp.C.shape[0]:
            self.assembly.resize(count)
            self._certificate = Certificate(self.assembly.qp)
            self._ready = False
        if rows is not None:
            qp = self.assembly.qp
            qp.C[:], qp.hi[:] = rows
            qp.lo[:] = -np.inf
