"""Strict priorities and preserved directions: a program a level, inside the optima above it.

Lexicographic least squares with inequalities: Kanoun, Lamiraux and Wieber 2011; the elimination of
the levels above by their null space is Escande, Mansard and Wieber's (2014).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmrc.qp.backends import Backend
from rmrc.qp.certificate import Certificate
from rmrc.qp.polish import Polish
from rmrc.qp.program import KKT, QP, Solution, SolveStatus

Array = NDArray[np.float64]

RANK = 1e-9
"""A singular value below this share of the largest of 1 and σ_max leaves its direction free."""
FASTEST = 1e-10
"""Weight of ‖v‖² beside (α − 1)²; α falls short of its maximum by at most its root times ‖v‖."""
POLISHED = 1e-10
"""A residual above this is worth a polish: the levels' programs can be nearly singular."""
REGULARIZATION = (0.0, 1e-9, 1e-7, 1e-5)
"""What is added to the diagonal, one after another, until a backend solves: these programs are
nearly singular, and v = 0 or z = 0 is feasible, so that a refusal is one of rounding."""
SOUND = 1e-7
"""A residual up to which a solution is taken without more regularization."""
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
    """Solves levels one after another, each in the null space of those above, inside one box.

    With v the optimum so far and N a basis of what is free, level k solves over z

        min ½ ‖W_k (v + N z) − S ẋ_k‖² + ½ (v + N z)ᵀ A (v + N z),  lb ≤ v + N z ≤ ub.

    v stays feasible, so that no level can fail for what another has done.
    """

    def __init__(self, size: int, backend: Callable[[], Backend]):
        self._size = size
        self._backend = backend
        self._solvers: dict[tuple[int, int, int], tuple[QP, Backend, Certificate]] = {}
        self.scale = 1.0
        """α of the last solve, the least of all preserved directions."""

    def solve(self, levels: list[Level], lb: Array, ub: Array) -> Solution:
        """Return the lexicographic optimum; its multipliers are summed over the levels."""
        self.scale = 1.0
        state = _State(np.clip(np.zeros(self._size), lb, ub), None, lb, ub)
        multiplier, kkt, iterations = np.zeros(self._size), [KKT(0.0, 0.0, 0.0)], 0
        status = SolveStatus.SOLVED
        for level, stage in (
            (level, s) for level in levels for s in (self._fastest, self._nearest)
        ):
            found = stage(level, state)
            if found is None:
                continue
            solution, fixed = found
            iterations += solution.iterations
            if solution.status is not SolveStatus.SOLVED:
                status = solution.status
                break
            multiplier += (
                solution.bound_multiplier if state.free is None else solution.row_multiplier
            )
            kkt.append(solution.kkt)
            if not state.move(solution.v, fixed):
                break
        worst = KKT(*(float(residual) for residual in np.max(kkt, axis=0)))
        empty = np.zeros(0)
        return Solution(state.v, multiplier, empty, empty, iterations, status, worst)

    def _nearest(self, level: Level, state: "_State") -> tuple[Solution, Array]:
        """Solve a level's least squares; what it fixes is W v."""
        hessian = level.rows.T @ level.rows + level.metric
        gradient = hessian @ state.v - level.rows.T @ level.rate
        qp, solve = self._program(state, 0, 0)
        qp.H[:] = state.reduced(state.reduced(hessian).T)
        qp.g[:] = state.reduced(gradient)
        state.bound(qp)
        return solve(), level.rows

    def _fastest(self, level: Level, state: "_State") -> tuple[Solution, Array] | None:
        """Maximise α in J (v + N z) = α ẋ, 0 ≤ α ≤ 1; what it fixes is J v.

        Only the part of ẋ that the free motion can give is asked for: at a singularity the rest is
        lost. Where even α = 0 is outside the box, as for a joint on its way back into its range,
        the level's least squares takes over.
        """
        if level.direction is None:
            return None
        jacobian, rate = level.direction
        reach = state.reduced(jacobian.T).T
        left, sigma, _ = np.linalg.svd(reach, full_matrices=False)
        left = left[:, sigma > RANK * max(1.0, float(sigma[0]))]
        wanted = left.T @ rate
        if not wanted.any():
            return None
        qp, solve = self._program(state, 1, left.shape[1])
        alpha = qp.g.size - 1
        qp.H[:] = FASTEST * np.eye(alpha + 1)
        qp.H[alpha, alpha] = 1.0
        qp.g[:alpha], qp.g[alpha] = FASTEST * state.reduced(state.v), -1.0
        state.bound(qp)
        qp.lb[alpha], qp.ub[alpha] = 0.0, 1.0
        qp.E[:, :alpha], qp.E[:, alpha] = left.T @ reach, -wanted
        qp.f[:] = -left.T @ (jacobian @ state.v)
        solution = solve()
        if solution.status is SolveStatus.INFEASIBLE:
            return None
        self.scale = min(self.scale, float(solution.v[alpha]))
        solution.v, solution.bound_multiplier = (
            solution.v[:alpha],
            solution.bound_multiplier[:alpha],
        )
        return solution, jacobian

    def _program(
        self, state: "_State", more: int, equalities: int
    ) -> tuple[QP, Callable[[], Solution]]:
        """Return the program of a shape, kept from step to step, and what solves it."""
        rows = 0 if state.free is None else self._size
        shape = (state.count + more, rows, equalities)
        if shape not in self._solvers:
            qp = QP(*shape)
            self._solvers[shape] = (qp, self._backend(), Certificate(qp))
        qp, backend, certificate = self._solvers[shape]

        def solve() -> Solution:
            solution = Solution.at_rest(qp)
            for more in REGULARIZATION:
                qp.H.flat[:: qp.g.size + 1] += more
                backend.setup(qp)
                solution = backend.solve()
                if certificate.certify(solution) > POLISHED:
                    solution = Polish(qp).improve(solution)
                    certificate.certify(solution)
                if solution.status is SolveStatus.SOLVED and max(solution.kkt) < SOUND:
                    break
            return solution

        return qp, solve


@dataclass(eq=False)
class _State:
    """v so far, and a basis N (n, r) of what is still free; None stands for the identity."""

    v: Array
    free: Array | None
    lb: Array
    ub: Array

    @property
    def count(self) -> int:
        """Number of free directions."""
        return self.v.size if self.free is None else self.free.shape[1]

    def reduced(self, array: Array) -> Array:
        """Return Nᵀ times an array (n, …)."""
        return array if self.free is None else self.free.T @ array

    def bound(self, qp: QP) -> None:
        """Write lb ≤ v + N z ≤ ub: as bounds while all is free, as rows afterwards.

        Rounding must not shut out z = 0.
        """
        low, high = np.minimum(self.lb - self.v, 0.0), np.maximum(self.ub - self.v, 0.0)
        if self.free is None:
            qp.lb[: self.count], qp.ub[: self.count] = low, high
        else:
            # A joint that the levels above have fixed has a row of rounding, which a solver that
            # scales rows would take for a limit.
            fixed = np.sqrt(np.einsum("ij,ij->i", self.free, self.free)) < RANK
            qp.C[:, : self.count], qp.lo[:], qp.hi[:] = self.free, low, high
            qp.C[fixed], qp.lo[fixed], qp.hi[fixed] = 0.0, -np.inf, np.inf

    def move(self, z: Array, fixed: Array) -> bool:
        """Add N z to v and keep only what leaves the rows `fixed` alone; return whether any is."""
        step = z if self.free is None else self.free @ z
        self.v = np.clip(self.v + step, self.lb, self.ub)
        inside = _null_space(self.reduced(fixed.T).T)
        self.free = inside if self.free is None else self.free @ inside
        return bool(self.free.shape[1])


def _null_space(matrix: Array) -> Array:
    """Return an orthonormal basis (n, r) of what a matrix (m, n) maps to zero."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, sigma, right = np.linalg.svd(matrix)
    rank = int(np.count_nonzero(sigma > RANK * max(1.0, sigma[0])))
    return right[rank:].T
