"""Any other solver, through qpsolvers: without a workspace, cold at every solve."""

from importlib.metadata import metadata
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
import qpsolvers
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from rmrc.errors import SolverError, unknown_name
from rmrc.qp.backends import BACKENDS, Backend
from rmrc.qp.program import QP, Array, Solution, SolveStatus

SETTINGS = {
    "clarabel": ("max_iter", ("tol_gap_abs", "tol_gap_rel", "tol_feas")),
    "cvxopt": ("maxiters", ("abstol", "reltol", "feastol")),
    "ecos": ("max_iters", ("abstol", "reltol", "feastol")),
    "piqp": ("max_iter", ("eps_abs",)),
    "qpalm": ("max_iter", ("eps_abs",)),
    "scs": ("max_iters", ("eps_abs",)),
}
"""What solvers call their limit on iterations and their tolerances; others take neither."""


class QpsolversAdapter(Backend):
    """A solver that qpsolvers offers, called afresh for each program, and polished.

    qpsolvers does not tell the iterations nor why there is no solution: `iterations` is 0, and
    what is not solved is FAILED. Raises SolverError for a name that qpsolvers does not know, a
    solver that is not installed, or a setting that the solver does not have.
    """

    def __init__(
        self, name: str, max_iter: int | None = None, tolerance: float | None = None
    ) -> None:
        super().__init__(polished=True)
        _require(name)
        self._name = name
        self._sparse = name not in qpsolvers.dense_solvers
        limit, tolerances = SETTINGS.get(name, (None, ()))
        self._options: dict[str, Any] = {}
        if max_iter is not None:
            if limit is None:
                raise SolverError(f"the QP backend '{name}' takes no max_iter")
            self._options[limit] = max_iter
        if tolerance is not None:
            if not tolerances:
                raise SolverError(f"the QP backend '{name}' takes no tolerance")
            self._options.update(dict.fromkeys(tolerances, tolerance))

    def _load(self, qp: QP) -> SolveStatus | None:
        return None

    def _refresh(self, qp: QP) -> SolveStatus | None:
        return None

    def _run(self, qp: QP) -> Solution:
        high, low = np.isfinite(qp.hi), np.isfinite(qp.lo)
        rows = np.vstack([qp.C[high], -qp.C[low]])
        limits = np.concatenate([qp.hi[high], -qp.lo[low]])
        matrix = csc_matrix if self._sparse else np.asarray
        inequalities = (matrix(rows), limits) if limits.size else (None, None)
        equalities = (matrix(qp.E), qp.f) if qp.f.size else (None, None)
        program = qpsolvers.Problem(
            matrix(qp.H), qp.g, *inequalities, *equalities, lb=qp.lb, ub=qp.ub
        )
        with catch_warnings():
            simplefilter("ignore")  # the status says what they say
            try:
                found = qpsolvers.solve_problem(program, self._name, **self._options)
            except Exception:  # every solver raises classes of its own
                return Solution.at_rest(qp)
        solution = Solution.at_rest(qp)
        if not found.found or found.x is None:
            return solution
        solution.v[:], solution.status = found.x, SolveStatus.SOLVED
        _set(solution.bound_multiplier, found.z_box)
        _set(solution.equality_multiplier, found.y)
        sides = np.zeros(limits.size)
        _set(sides, found.z)
        count = np.count_nonzero(high)
        solution.row_multiplier[high] += sides[:count]
        solution.row_multiplier[low] -= sides[count:]
        return solution


def _set(multiplier: Array, found: ArrayLike | None) -> None:
    """Copy a multiplier that the solver may have left out."""
    if found is not None and np.size(found):
        multiplier[:] = found


def _require(name: str) -> None:
    """Raise SolverError unless qpsolvers has the solver installed."""
    if name in qpsolvers.available_solvers:
        return
    others = [other for other in qpsolvers.available_solvers if other not in BACKENDS]
    if not hasattr(qpsolvers.solvers, f"{name}_solve_problem"):
        raise SolverError(unknown_name("QP backend", name, [*BACKENDS, *others]))
    if name in (metadata("qpsolvers").get_all("Provides-Extra") or ()):
        advice = f"pip install 'qpsolvers[{name}]'"
    else:
        advice = "the documentation of qpsolvers says where it comes from"
    raise SolverError(f"the QP backend '{name}' is not installed: {advice}")
