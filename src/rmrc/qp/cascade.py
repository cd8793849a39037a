"""Strict priorities and preserved directions: a program a level, inside the optima above it.

Lexicographic least squares with inequalities: Kanoun, Lamiraux and Wieber 2011; the elimination of
the levels above by their null space is Escande, Mansard and Wieber's (2014).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from rmrc.qp.backends.base import Backend
from rmrc.qp.certificate import Certificate
from rmrc.qp.polish import Polish
from rmrc.qp.program import KKT, QP, Solution, SolveStatus

Array = NDArray[np.float64]

RANK = 1e-9
"""A singular value below this share of the largest of 1 and σ_max leaves its direction free."""
WORTH = 1e-6
"""What ½‖v‖²/κ² weighs beside α, for the least ‖v‖ = κ that α = 1 takes. What gains more of α for
its length is found exactly; a rush that gains less, as in the null space, is not worth it."""
LOST = 0.02
"""Share of ẋ that the free motion must be able to give, or there is no direction to preserve."""
BRISK = 10.0
"""Most that κ counts for there, rad/s or m/s: near a singularity it has no bound."""
POLISHED = 1e-10
"""A residual above this is worth a polish: the levels' programs can be nearly singular."""
ATTEMPTS = (
    *((0.0, 0.0), (1e-9, 0.0), (1e-7, 0.0), (0.0, 1e-11)),
    *((0.0, 1e-10), (1e-5, 0.0), (0.0, 1e-8), (0.0, 1e-7)),
)
"""What is added to the diagonal and to the room of the rows, one pair on top of another, until a
backend solves. These programs are nearly singular, with more limits at a corner than variables;
but z = 0 is feasible, so that a refusal is one of rounding. The box still clips v. Only the first
point inside the limits may be refused for good."""
SOUND = 1e-7
"""A residual up to which a solution is taken: of limits in rad/s or m/s, of the others relative to
the largest of 1 and ‖g‖."""
STILL = 1e-8
"""A limit that a unit of free motion moves less than this is taken for fixed by those above."""
EXACT = 1e-12
"""By how much rounding makes v pass a row or miss an equality, rad/s or m/s."""
WHOLE = 1e-6
"""A task whose α is less than 1 by more than this runs slower than asked."""


@dataclass(frozen=True, eq=False)
class Level:
    """What one level of priority asks of v (n,)."""

    rows: Array
    """W = S J (m, n) of its tasks."""
    rate: Array
    """S ẋ (m,)."""
    metric: Array
    """What is added to WᵀW (n, n): A where it belongs, and λ²I."""
    direction: tuple[Array, Array] | None = None
    """J (k, n) and ẋ (k,) of the tasks that move along ẋ, as fast as the limits allow."""


class Cascade:
    """Solves levels one after another, each in the null space of those above, inside all limits.

    With v the optimum so far and N a basis of what is free, first the null space of E, level k
    solves over z

        min ½ ‖W_k (v + N z) − S ẋ_k‖² + ½ (v + N z)ᵀ A (v + N z)
        s.t.  lb ≤ v + N z ≤ ub,  lo ≤ C (v + N z) ≤ hi.

    v stays feasible, so that no level can fail for what another has done.
    """

    def __init__(self, size: int, backend: Callable[[], Backend]):
        self._size = size
        self._backend = backend
        self._rows = 0
        self._solvers: dict[tuple[int, int, int], tuple[QP, Backend, Certificate]] = {}
        self.scale = 1.0
        """α of the last solve, the least of all preserved directions."""
        self.optima: list[Array] = []
        """v_k (n,) of the levels that were solved, the highest first."""
        self.directed: list[Array | None] = []
        """v (n,) of each level once its directions were found, before its other tasks were; where
        they were not found, v_k, and None where nothing was."""
        self.deadline = math.inf
        """When solving has to end, s, by `time.perf_counter`."""

    def solve(self, levels: list[Level], limits: QP) -> Solution:
        """Return the lexicographic optimum inside the limits of a program, whose cost is not read.

        The multipliers of bounds and rows are summed over the levels; those of equalities stay 0.
        INFEASIBLE: no v was found inside the limits; the residuals are infinite. MAX_ITER: a level
        could not be solved; v is the feasible optimum of those above it. TIME_LIMIT: either of the
        two, which the primal residual tells apart.
        """
        self.scale = 1.0
        if limits.lo.size != self._rows:  # else a program of each number would be kept
            self._rows = limits.lo.size
            self._solvers.clear()
        answer = Solution.at_rest(limits, SolveStatus.SOLVED)
        state = _State(limits)
        entry = self._enter(state)
        if entry is not None and entry.status is not SolveStatus.SOLVED:
            answer.v, answer.status = state.v, _unsolved(entry, SolveStatus.INFEASIBLE)
            self.optima, self.directed = [state.v], []
            return answer
        kkt = [KKT(0.0, 0.0, 0.0) if entry is None else entry.kkt]
        self.optima, self.directed = [], []
        for level, stage in (
            (level, s) for level in levels for s in (self._fastest, self._nearest)
        ):
            if not state.count:
                break
            if stage == self._fastest:
                self.directed.append(None)
                if level is not levels[0]:
                    self.optima.append(state.v)
            found = stage(level, state)
            if found is None:
                continue
            solution, reach = found
            answer.iterations += solution.iterations
            if solution.status is not SolveStatus.SOLVED:
                answer.status = _unsolved(solution, SolveStatus.MAX_ITER)
                break
            state.add_multipliers(solution, answer)
            kkt.append(solution.kkt)
            state.move(solution.v, reach)
            if self.directed[-1] is None:  # else it was found by the stage before
                self.directed[-1] = state.v
        answer.v = state.v
        self.optima.append(state.v)
        primal, dual, complementarity = map(max, zip(*kkt, strict=True))
        answer.kkt = KKT(max(primal, state.passed()), dual, complementarity)
        return answer

    def _enter(self, state: "_State") -> Solution | None:
        """Move v to the feasible point nearest to rest, and free what the equalities leave.

        Return the projection, or None where v is feasible as it is.
        """
        limits, entry = state.limits, None
        if not state.passed() <= EXACT:  # nor if that is not a number
            qp, solve = self._program(self._size, limits.lo.size, limits.f.size)
            qp.H[:], qp.g[:], qp.lb[:], qp.ub[:] = np.eye(self._size), 0.0, limits.lb, limits.ub
            qp.C[:], qp.lo[:], qp.hi[:] = limits.C, limits.lo, limits.hi
            qp.E[:], qp.f[:] = limits.E, limits.f
            entry = solve(refusable=True)
            if entry.status is not SolveStatus.SOLVED:
                return entry
            state.v = entry.v
        if limits.f.size:
            state.free = _null_space(limits.E)
        return entry

    def _nearest(self, level: Level, state: "_State") -> tuple[Solution, Array] | None:
        """Solve a level's least squares; return W N, which fixes W v.

        Rows that nothing free moves, as after a preserved direction, have nothing to fix.
        """
        reach = state.reduced(level.rows.T).T
        if reach.size and np.vdot(reach, reach) <= RANK**2:
            return None
        qp, solve = self._program(state.count, state.rows)
        metric = state.reduced(state.reduced(level.metric).T)
        np.add(reach.T @ reach, metric, out=qp.H)
        qp.g[:] = reach.T @ (level.rows @ state.v - level.rate)
        qp.g += state.reduced(level.metric @ state.v)
        state.bound(qp)
        return solve(), reach

    def _fastest(self, level: Level, state: "_State") -> tuple[Solution, Array] | None:
        """Maximise α − ½ 10⁻⁶ ‖v + N z‖²/κ² in J (v + N z) = α ẋ, 0 ≤ α ≤ 1; return J N.

        J N fixes J v. κ is the length of the least N z for α = 1: α is at its maximum where a
        motion gains more of it than that costs, and v is continuous where it gains less. Only the
        part of ẋ that the free motion can give is asked for: at a singularity the rest is lost;
        along ẋ = 0 nothing moves. Where even α = 0 is outside the limits, as for a joint on its
        way back into its range, the level's least squares takes over.
        """
        if level.direction is None:
            return None
        jacobian, rate = level.direction
        reach = state.reduced(jacobian.T).T
        left, sigma, _ = np.linalg.svd(reach, full_matrices=False)
        kept = sigma > RANK * max(1.0, float(sigma[0]))
        left = left[:, kept]
        if not left.size or np.linalg.norm(left.T @ rate) < LOST * np.linalg.norm(rate):
            return None
        left = left / sigma[kept]
        wanted = left.T @ rate
        least = float(np.linalg.norm(wanted))  # κ
        qp, solve = self._program(state.count + 1, state.rows, left.shape[1])
        # t = κ α, so that all variables are rates; there is no way along ẋ = 0.
        along = state.count
        np.fill_diagonal(qp.H, 1.0)
        qp.g[:along], qp.g[along] = state.reduced(state.v), -min(least, BRISK) / WORTH
        state.bound(qp)
        qp.lb[along], qp.ub[along] = 0.0, least
        qp.E[:, :along], qp.E[:, along] = left.T @ reach, -wanted / least if least else 0.0
        qp.f[:] = -left.T @ (jacobian @ state.v)
        solution = solve()
        if solution.status is SolveStatus.INFEASIBLE:
            return None
        if solution.status is SolveStatus.SOLVED and least:
            self.scale = min(self.scale, float(solution.v[along]) / least)
        # In the unit of α, as that of a cost whose largest weight is 1.
        share = min(1.0, WORTH / (least * min(least, BRISK))) if least else 1.0
        solution.v = solution.v[:along]
        solution.bound_multiplier = share * solution.bound_multiplier[:along]
        solution.row_multiplier = share * solution.row_multiplier
        primal, dual, complementarity = solution.kkt
        solution.kkt = KKT(primal, share * dual, share * complementarity)
        return solution, reach

    def _program(
        self, size: int, rows: int, equalities: int = 0
    ) -> tuple[QP, Callable[..., Solution]]:
        """Return the program of a shape, kept from step to step, and what solves it.

        What is refusable may have no solution; that any other has none is rounding.
        """
        shape = (size, rows, equalities)
        if shape not in self._solvers:
            qp = QP(*shape)
            self._solvers[shape] = (qp, self._backend(), Certificate(qp))
        qp, backend, certificate = self._solvers[shape]

        def solve(refusable: bool = False) -> Solution:
            solution = Solution.at_rest(qp)
            for more, wider in ATTEMPTS:
                if more:
                    qp.H.flat[:: size + 1] += more
                if wider:
                    qp.lo -= wider
                    qp.hi += wider
                if self.deadline < math.inf:
                    backend.allow(self.deadline - perf_counter())
                backend.setup(qp)
                solution = backend.solve()
                refused = solution.status is SolveStatus.INFEASIBLE
                if refused and refusable:
                    return solution
                if certificate.certify(solution) > POLISHED and not refused:
                    solution = Polish(qp).improve(solution)
                    certificate.certify(solution)
                if _is_sound(solution, qp) or solution.status is SolveStatus.TIME_LIMIT:
                    return solution
            if solution.status is SolveStatus.SOLVED:
                solution.status = SolveStatus.MAX_ITER
            return solution

        return qp, solve


class _State:
    """v so far, and a basis N (n, r) of what is still free; None stands for the identity."""

    def __init__(self, limits: QP) -> None:
        self.limits = limits
        self.v = np.minimum(np.maximum(0.0, limits.lb), limits.ub)
        self.free: Array | None = None
        self._low, self._high = limits.lb, limits.ub
        if limits.lo.size:
            self._low = np.concatenate([limits.lb, limits.lo])
            self._high = np.concatenate([limits.ub, limits.hi])
        self._norm = np.ones(0)

    @property
    def count(self) -> int:
        """Number of free directions."""
        return self.v.size if self.free is None else self.free.shape[1]

    @property
    def rows(self) -> int:
        """Number of limits that are rows of a program over z."""
        return self.limits.lo.size if self.free is None else self._low.size

    def reduced(self, array: Array) -> Array:
        """Return Nᵀ times an array (n, …)."""
        return array if self.free is None else self.free.T @ array

    def _limited(self, motion: Array) -> Array:
        """Return what of a motion (n, …) the limits are on: itself, and below it C times it."""
        matrix = self.limits.C
        return np.concatenate([motion, matrix @ motion]) if len(matrix) else motion

    def passed(self) -> float:
        """Return by how much v passes the rows or misses the equalities, at most."""
        limits, worst = self.limits, 0.0
        if limits.lo.size:
            at = limits.C @ self.v
            worst = max(float(np.maximum(limits.lo - at, at - limits.hi).max()), 0.0)
        if limits.f.size:
            worst = max(float(np.abs(limits.E @ self.v - limits.f).max()), worst)
        return worst

    def bound(self, qp: QP) -> None:
        """Write the limits of v + N z: as they are while all is free, as unit rows afterwards.

        Rounding must not shut out z = 0.
        """
        at, n = self._limited(self.v), self.v.size
        low, high = np.minimum(self._low - at, 0.0), np.maximum(self._high - at, 0.0)
        if self.free is None:
            qp.lb[:n], qp.ub[:n], qp.lo[:], qp.hi[:] = low[:n], high[:n], low[n:], high[n:]
            qp.C[:, :n] = self.limits.C
            return
        moved = self._limited(self.free)
        norm = np.sqrt(np.einsum("ij,ij->i", moved, moved))
        # DAQP ignores rows shorter than 3e-6: all are made units, but for those of what the levels
        # above have fixed, which are rounding and no limits.
        still = norm < STILL
        if fixed := still.any():
            norm[still] = 1.0
        np.divide(moved, norm[:, None], out=qp.C[:, : self.count])
        np.divide(low, norm, out=qp.lo)
        np.divide(high, norm, out=qp.hi)
        if fixed:
            qp.C[still] = 0.0
        self._norm = norm

    def add_multipliers(self, solution: Solution, total: Solution) -> None:
        """Add those of the program that was bound last."""
        bound, rows = solution.bound_multiplier, solution.row_multiplier
        if self.free is not None:
            rows = rows / self._norm
            bound, rows = rows[: self.v.size], rows[self.v.size :]
        total.bound_multiplier += bound
        total.row_multiplier += rows

    def move(self, z: Array, reach: Array) -> None:
        """Add N z to v and keep free only what `reach` (m, r), rows times N, maps to zero."""
        step = z if self.free is None else self.free @ z
        self.v = np.minimum(np.maximum(self.v + step, self.limits.lb), self.limits.ub)
        inside = _null_space(reach)
        self.free = inside if self.free is None else self.free @ inside


def _unsolved(solution: Solution, status: SolveStatus) -> SolveStatus:
    """Return the status of an answer for want of this solution."""
    timed_out = solution.status is SolveStatus.TIME_LIMIT
    return SolveStatus.TIME_LIMIT if timed_out else status


def _is_sound(solution: Solution, qp: QP) -> bool:
    primal, dual, complementarity = solution.kkt
    scale = max(1.0, math.sqrt(qp.g.dot(qp.g)))
    return (
        solution.status is SolveStatus.SOLVED
        and primal < SOUND
        and max(dual, complementarity) < SOUND * scale
    )


def _null_space(matrix: Array) -> Array:
    """Return an orthonormal basis (n, r) of what a matrix (m, n) maps to zero."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, sigma, right = np.linalg.svd(matrix)
    rank = int(np.count_nonzero(sigma > RANK * max(1.0, sigma[0])))
    return right[rank:].T
