"""The quadratic program of a step, assembled in place."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.limits.box import BoxLimit
from rmrc.problem.problem import Problem
from rmrc.problem.tasks.base import Term
from rmrc.qp.cascade import Level
from rmrc.qp.program import QP

Array = NDArray[np.float64]


def square_root(weight: Array) -> Array:
    """Return S with B = SᵀS: of a diagonal element by element, of a matrix by its eigenvectors."""
    if weight.ndim == 1:
        return np.sqrt(weight)
    values, vectors = np.linalg.eigh(weight)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


LEAST_DAMPING = 1e-12
"""λ² at a level, where the configuration has less: it keeps a level's program definite."""


class Assembly:
    """Writes a problem's program into a `QP` at every step.

    min_v Σ ½ (J v − ẋ)ᵀ B (J v − ẋ) + ½ vᵀ A v + ½ λ² ‖v‖², with ẋ = K clamp(e) + ẋ_ff, so that
    H = Σ JᵀBJ + A + λ²I and g = −Σ JᵀB ẋ. The terms with rows go in as W = S J with B = SᵀS, one
    product WᵀW for all of them; those on the joints themselves add their B as it is.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation):
        self._problem, self._evaluation = problem, evaluation
        self._dofs = problem.dofs
        self._all = problem.dofs.size == problem.model.nv
        self.qp = QP(problem.dofs.size, rows=0)
        self.box = BoxLimit(problem.box)
        rows = evaluation.row_count
        self.unit = self._unit()
        """What the whole cost is multiplied by, so that its largest weight is 1."""
        self._gain = np.concatenate([np.full(t.rows, t.gain) for t in evaluation.terms] or [[]])
        self._gain_dt = 0.0
        self._capped = self._gain.copy()
        self.rate = np.empty_like(self._gain)
        """ẋ = K e + ẋ_ff of all terms at the last assembly."""
        self._row_rate = self.rate[:rows]
        self._fed = any(term.joint and not term.gain for term in evaluation.terms)
        self._clamps = [
            (
                evaluation.error_of(evaluation.error, term)[part],
                evaluation.error_of(self.rate, term)[part],
                longest,
            )
            for term in evaluation.terms
            for part, longest in term.clamps
        ]
        scale, self._roots = self._row_weights()
        self._minus_scale = -scale
        # Of J's own shape: multiplying takes a third of the time that it takes with a column.
        self._scale = np.repeat(scale[:, None], problem.model.nv, axis=1)
        self._weighted = np.empty((rows, problem.model.nv))
        self._unwanted = np.empty(rows)
        joint_terms = [term for term in evaluation.terms if term.joint]
        self._joint_weights = np.array([self._diagonal(term) for term in joint_terms])
        self._minus_joint_weights = -self._joint_weights
        self._joint_rates = self.rate[rows:].reshape(len(joint_terms), problem.model.nv)
        self._joint_matrices = [
            (k, self._leveled(term)) for k, term in enumerate(joint_terms) if term.weight.ndim == 2
        ]
        self._constant = self._constant_hessian()
        self._leveled_terms = [
            [term for term in evaluation.terms if term.level == level]
            for level in sorted({term.level for term in evaluation.terms})
        ]
        self._inertia = np.empty((problem.model.nv, problem.model.nv))
        self._gradient = np.empty(problem.model.nv)

    def _unit(self) -> float:
        """Return the inverse of the largest weight.

        A cost times a constant has the same optimum, but tolerances on multipliers and residuals
        mean something only where the numbers are of the order of 1.
        """
        problem = self._problem
        weights = [problem.damping**2, *np.diagonal(problem.metric)]
        weights += [problem.inertia * problem.model.dof_M0.max()]
        for term in self._evaluation.terms:
            diagonal = term.weight if term.weight.ndim == 1 else np.diagonal(term.weight)
            weights.append(diagonal.max() * problem.soft_ratio**term.level)
        largest = float(max(weights))
        return 1.0 / largest if largest > 0.0 else 1.0

    def _leveled(self, term: Term) -> Array:
        """Return B in the program's unit, times `soft_ratio` for each level above the term's."""
        return term.weight * (self.unit * self._problem.soft_ratio**term.level)

    def _diagonal(self, term: Term) -> Array:
        weight = self._leveled(term)
        return weight if weight.ndim == 1 else np.zeros(weight.shape[0])

    def _row_weights(self) -> tuple[Array, list[tuple[slice, Array]]]:
        """Return S over all rows, 1 where a full S stands in the list instead."""
        scale = np.ones(self._evaluation.row_count)
        roots = []
        for term in self._evaluation.terms:
            if term.joint:
                continue
            rows, root = self._evaluation.rows_of([term]), square_root(self._leveled(term))
            if root.ndim == 1:
                scale[rows] = root
            else:
                roots.append((rows, root))
        return scale, roots

    def _constant_hessian(self) -> Array:
        """Return A + λ²I + Σ B of the joint terms (n, n), what no configuration changes."""
        problem = self._problem
        full = self.unit * (problem.metric + problem.damping**2 * np.eye(problem.model.nv))
        full += np.diag(self._joint_weights.sum(axis=0)) if len(self._joint_weights) else 0.0
        for _, matrix in self._joint_matrices:
            full += matrix
        return np.ascontiguousarray(full[np.ix_(self._dofs, self._dofs)])

    def assemble(self, q: Array, dt: float) -> bool:
        """Write the program at q (nq,) for a step of dt; return whether a joint is outside."""
        self._assemble_objective(dt)
        if self._problem.mink_tasks:
            self._add_mink_tasks(dt)
        v_previous = self._evaluation.v_previous
        outside = self.box.update(q, v_previous if self._all else v_previous[self._dofs], dt)
        self.qp.lb[:], self.qp.ub[:] = self.box.lower, self.box.upper
        return outside

    def _assemble_objective(self, dt: float) -> None:
        evaluation, qp = self._evaluation, self.qp
        if dt != self._gain_dt:
            # A gain above 1/dt would step past the target.
            np.minimum(self._gain, 1.0 / dt, out=self._capped)
            self._gain_dt = dt
        weighted, unwanted = self._weighted, self._unwanted
        np.multiply(self._capped, evaluation.error, out=self.rate)  # K e
        for error, rate, longest in self._clamps:
            length = math.sqrt(error.dot(error))
            if length > longest:
                rate *= longest / length
        if self._fed or evaluation.moving:
            self.rate += evaluation.feedforward  # ẋ = K clamp(e) + ẋ_ff
        np.multiply(self._scale, evaluation.jacobian, out=weighted)  # W = S J
        np.multiply(self._minus_scale, self._row_rate, out=unwanted)  # −S ẋ
        for part, root in self._roots:
            weighted[part] = root @ weighted[part]
            unwanted[part] = root @ unwanted[part]
        columns = weighted if self._all else weighted[:, self._dofs]
        columns.T.dot(columns, qp.H)  # Σ JᵀBJ
        qp.H += self._constant  # + A + λ²I + Σ B
        unwanted.dot(columns, qp.g)  # −Σ JᵀB ẋ
        if len(self._joint_rates):
            self._add_joint_rates()
        if self._problem.inertia:
            self._add_inertia()

    def _add_joint_rates(self) -> None:
        """Subtract Σ B ẋ of the terms on the joints."""
        gradient = self._gradient
        if len(self._joint_rates) == 1:
            np.multiply(self._minus_joint_weights[0], self._joint_rates[0], out=gradient)
        else:
            np.einsum("kj,kj->j", self._minus_joint_weights, self._joint_rates, out=gradient)
        for k, matrix in self._joint_matrices:
            gradient -= matrix @ self._joint_rates[k]
        self.qp.g += gradient if self._all else gradient[self._dofs]

    def _add_inertia(self) -> None:
        """Add the share of M(q) in the metric."""
        evaluation = self._evaluation
        mujoco.mj_makeM(evaluation.model, evaluation.data)
        mujoco.mj_fullM(evaluation.model, evaluation.data, self._inertia)
        matrix = self._inertia if self._all else self._inertia[np.ix_(self._dofs, self._dofs)]
        self.qp.H += self.unit * self._problem.inertia * matrix

    def _add_mink_tasks(self, dt: float) -> None:
        """Add mink's tasks, whose variable is Δq = v dt: divided by dt², W Δq ≈ r is W v ≈ r/dt."""
        qp, dofs = self.qp, self._dofs
        configuration = self._evaluation.configuration
        for task in self._problem.mink_tasks:
            residual = task.compute_qp_residual(configuration)
            if residual is None:
                objective = task.compute_qp_objective(configuration)
                qp.H += self.unit * objective.H[np.ix_(dofs, dofs)]
                qp.g += self.unit * objective.c[dofs] / dt
                continue
            columns = residual[0][:, dofs]
            qp.H += self.unit * columns.T @ columns
            qp.H.flat[:: dofs.size + 1] += self.unit * residual[2]
            qp.g -= self.unit * residual[1] @ columns / dt

    def metric(self) -> Array:
        """Return A (n, n) at the present assembly, in the configuration's own unit."""
        chosen = np.ix_(self._dofs, self._dofs)
        metric = self._problem.metric[chosen]
        if self._problem.inertia:
            metric = metric + self._problem.inertia * self._inertia[chosen]
        return metric

    def levels(self) -> list[Level]:
        """Return what each level asks for at the present assembly, the highest first.

        Last comes what picks among equal motions: A, or the least norm.
        """
        n = self._dofs.size
        damping = max(self.unit * self._problem.damping**2, LEAST_DAMPING) * np.eye(n)
        metric = self.unit * self.metric()
        metric = metric + damping if metric.any() else np.eye(n)
        return [
            *(self._level(level, damping) for level in self._leveled_terms),
            Level(np.zeros((0, n)), np.zeros(0), metric),
        ]

    def _level(self, terms: list[Term], damping: Array) -> Level:
        rows, rates, directions = [], [], []
        for term in terms:
            part = self._evaluation.rows_of([term])
            if term.joint:
                root = square_root(self._leveled(term))
                root = np.diag(root) if root.ndim == 1 else root
                root = root[np.any(root != 0.0, axis=1)]
                rows.append(root[:, self._dofs])
                rates.append(root @ self.rate[part])
                continue
            rows.append(self._weighted[part][:, self._dofs])
            rates.append(-self._unwanted[part])
            if term.preserve:
                weight = term.weight
                weighed = (weight if weight.ndim == 1 else np.diagonal(weight)) > 0.0
                jacobian = self._evaluation.jacobian[part][weighed]
                directions.append((jacobian[:, self._dofs], self.rate[part][weighed]))
        direction = None
        if directions:
            jacobians, wanted = zip(*directions, strict=True)
            direction = (np.vstack(jacobians), np.concatenate(wanted))
        return Level(np.vstack(rows), np.concatenate(rates), damping, direction)

    def sigma_min(self) -> float:
        """Return the least singular value of W = S J over the rows that have a weight.

        NaN without any such row. With more dofs than rows it is that of WWᵀ, so that a task that
        leaves dofs free is not singular for it.
        """
        rows = self._weighted[np.any(self._weighted != 0.0, axis=1)]
        if not rows.size:
            return np.nan
        least = float(np.linalg.svd(rows[:, self._dofs], compute_uv=False)[-1])
        return least / math.sqrt(self.unit)

    def resize(self, rows: int) -> None:
        """Give the program another number of rows; the next solve must set its backend up anew."""
        old, self.qp = self.qp, QP(self._dofs.size, rows=rows)
        self.qp.H[:], self.qp.g[:], self.qp.lb[:], self.qp.ub[:] = old.H, old.g, old.lb, old.ub

    def mink_rows(self, dt: float) -> tuple[Array, Array] | None:
        """Return the rows C v ≤ hi of mink's limits, which say G Δq ≤ h; None without any."""
        found = []
        for limit in self._problem.mink_limits:
            constraint = limit.compute_qp_inequalities(self._evaluation.configuration, dt)
            if constraint.G is not None and constraint.h is not None:
                found.append((constraint.G[:, self._dofs], constraint.h / dt))
        if not found:
            return None
        return np.vstack([g for g, _ in found]), np.concatenate([h for _, h in found])
