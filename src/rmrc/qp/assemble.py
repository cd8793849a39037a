"""The quadratic program of a step, assembled in place."""

import math

import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.limits.box import BoxLimit
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.braking import Braking
from rmrc.qp.cascade import Level
from rmrc.qp.curvature import Curvature
from rmrc.qp.damping import Damping, largest_square
from rmrc.qp.equalities import Equalities
from rmrc.qp.foreign import checked, parts, unpacked
from rmrc.qp.program import QP
from rmrc.qp.yielding import Yielding
from rmrc.tasks.base import Term, square_root

Array = NDArray[np.float64]

LEAST_DAMPING = 1e-12
"""λ² at a level, where the configuration has less: it keeps a level's program definite."""


class Assembly:
    """Writes a problem's program into a `QP` at every step.

    min_v Σ ½ (J v − ẋ)ᵀ B (J v − ẋ) + ½ vᵀ A v + ½ λ² ‖v‖², with ẋ = K clamp(e) + ẋ_ff, so that
    H = Σ JᵀBJ + A + λ²I and g = −Σ JᵀB ẋ. The terms with rows go in as W = S J with B = SᵀS, one
    product WᵀW for all of them; those on the joints themselves add their B as it is. Hard tasks
    have no part in the cost: their rows of W are zero.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation):
        self._problem, self._evaluation = problem, evaluation
        self._dofs = problem.dofs
        self._all = problem.dofs.size == problem.model.nv
        self.qp = QP(problem.dofs.size)
        self._programs = {(0, 0): self.qp}
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
        # What mocap bodies carry may move whenever they do.
        self._fed = bool(problem.model.nmocap) or any(
            term.joint and not term.gain for term in evaluation.terms
        )
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
            (k, self.leveled(term)) for k, term in enumerate(joint_terms) if term.weight.ndim == 2
        ]
        self.constant = self._constant_hessian()
        """A + λ₀²I + Σ B of the joint terms (n, n), what no configuration changes."""
        self.curvature = Curvature(problem, evaluation, self.leveled)
        self.braking = Braking(problem.box)
        self.adaptive = Damping(problem, evaluation, self._weigh, self.unit)
        soft = [term for term in evaluation.terms if not term.hard]
        self.leveled_terms = [
            [term for term in soft if term.level == level]
            for level in sorted({term.level for term in soft})
        ]
        """The terms of each level, the highest first."""
        self.yielding = Yielding(
            problem, self.curvature, self.leveled, self.leveled_terms, self.rate, self.qp
        )
        self.inertia = np.empty((problem.model.nv, problem.model.nv))
        """M(q) (nv, nv) at the last assembly, where A has a share of it."""
        self._gradient = np.empty(problem.model.nv)

    def _unit(self) -> float:
        """Return the inverse of the largest weight.

        A cost times a constant has the same optimum, but tolerances on multipliers and residuals
        mean something only where the numbers are of the order of 1.
        """
        problem = self._problem
        weights = [largest_square(problem), *np.diagonal(problem.metric)]
        weights += [problem.inertia * problem.model.dof_M0[problem.dofs].max()]
        for term in self._evaluation.terms:
            if term.hard:
                continue
            weights.append(term.diagonal.max() * problem.soft_ratio**term.level)
        largest = float(max(weights))
        return 1.0 / largest if largest > 0.0 else 1.0

    def leveled(self, term: Term) -> Array:
        """Return B in the program's unit, times `soft_ratio` for each level above the term's.

        It is zero for a hard task, which is no cost.
        """
        if term.hard:
            return np.zeros_like(term.weight)
        return term.weight * (self.unit * self._problem.soft_ratio**term.level)

    def _diagonal(self, term: Term) -> Array:
        weight = self.leveled(term)
        return weight if weight.ndim == 1 else np.zeros(weight.shape[0])

    def _row_weights(self) -> tuple[Array, list[tuple[slice, Array]]]:
        """Return S over all rows, 1 where a full S stands in the list instead."""
        scale = np.ones(self._evaluation.row_count)
        roots = []
        for term in self._evaluation.terms:
            if term.joint:
                continue
            rows, root = self._evaluation.rows_of([term]), square_root(self.leveled(term))
            if root.ndim == 1:
                scale[rows] = root
            else:
                roots.append((rows, root))
        return scale, roots

    def _weigh(self) -> Array:
        """Return W = S J at the present evaluation, in a buffer kept."""
        np.multiply(self._scale, self._evaluation.jacobian, out=self._weighted)
        for part, root in self._roots:
            self._weighted[part] = root @ self._weighted[part]
        return self._weighted

    def _weigh_rate(self) -> Array:
        """Return −S ẋ at the present ẋ, in a buffer kept."""
        unwanted = np.multiply(self._minus_scale, self._row_rate, out=self._unwanted)
        for part, root in self._roots:
            unwanted[part] = root @ unwanted[part]
        return unwanted

    def _constant_hessian(self) -> Array:
        """Return A + λ₀²I + Σ B of the joint terms (n, n), what no configuration changes."""
        problem = self._problem
        full = self.unit * (problem.metric + problem.damping**2 * np.eye(problem.model.nv))
        full += np.diag(self._joint_weights.sum(axis=0)) if len(self._joint_weights) else 0.0
        for _, matrix in self._joint_matrices:
            full += matrix
        return np.ascontiguousarray(full[np.ix_(self._dofs, self._dofs)])

    def assemble(self, q: Array, dt: float) -> bool:
        """Write the program at q (nq,) for a step of dt; return whether a joint is outside."""
        self._assemble_objective(dt)
        self.add_mink_tasks(dt)
        return self.assemble_box(q, dt)

    def assemble_box(self, q: Array, dt: float) -> bool:
        """Write the box alone; return whether a joint is outside."""
        v_previous, a_previous = self._evaluation.v_previous, self._evaluation.a_previous
        if not self._all:
            v_previous, a_previous = v_previous[self._dofs], a_previous[self._dofs]
        outside = self.box.update(q, v_previous, a_previous, dt)
        self.qp.lb[:], self.qp.ub[:] = self.box.lower, self.box.upper
        return outside

    def _assemble_objective(self, dt: float) -> None:
        evaluation, qp = self._evaluation, self.qp
        if dt != self._gain_dt:
            # A gain above 1/dt would step past the target.
            np.minimum(self._gain, 1.0 / dt, out=self._capped)
            self._gain_dt = dt
        np.multiply(self._capped, evaluation.error, out=self.rate)  # K e
        for error, rate, longest in self._clamps:
            length = math.sqrt(error.dot(error))
            if length > longest:
                rate *= longest / length
        self.curvature.update(self.rate, dt)
        unfed = self.rate.copy()
        if self._fed or 1 in evaluation.moving:
            self.rate += evaluation.feedforward  # ẋ = K clamp(e) + ẋ_ff
        weighted, unwanted = self._weigh(), self._weigh_rate()
        columns = weighted if self._all else weighted[:, self._dofs]
        columns.T.dot(columns, qp.H)  # Σ JᵀBJ
        qp.H += self.constant  # + A + λ₀²I + Σ B
        for diagonal in self.curvature.levels.values():
            qp.H.flat[:: self._dofs.size + 1] += diagonal  # + X
        if self.adaptive.adapts:
            qp.H.flat[:: self._dofs.size + 1] += self.unit * self.adaptive.update()  # + λ_a²I
        unwanted.dot(columns, qp.g)  # −Σ JᵀB ẋ
        if len(self._joint_rates):
            self._add_joint_rates()
        if self._problem.inertia:
            self._add_inertia()
        if self._problem.curvature and self.braking.brakes:
            self._brake_in_time(unfed, dt)

    def _brake_in_time(self, unfed: Array, dt: float) -> None:
        """Slow down what drives the errors, K clamp(e) (rows,) of all terms: see `Braking`."""
        evaluation, qp = self._evaluation, self.qp
        driven, way = np.zeros((2, self._problem.model.nv))
        gain = 0.0
        for term in evaluation.terms:
            if term.hard or not (term.gain and term.weight.any()):
                continue
            weight, part = self.leveled(term), evaluation.error_of(unfed, term)
            pulled = weight * part if weight.ndim == 1 else weight @ part
            if not term.joint:
                pulled = evaluation.jacobian[evaluation.rows_of([term])].T @ pulled
            capped = min(term.gain, 1.0 / dt)
            driven += pulled
            way += pulled / capped
            gain = max(gain, capped)
        if not gain:
            return
        pulled = np.stack([driven, way], axis=1)[self._dofs]
        try:
            np.linalg.cholesky(qp.H)
            v, way = np.linalg.solve(qp.H, pulled).T
        except np.linalg.LinAlgError:  # no one optimum, where nothing is damped
            return
        share, slope = self.braking.field(v, way, gain, dt)
        if self._problem.cascaded:
            soft = np.concatenate(
                [
                    np.full(t.rows, 0.0 if t.hard or not t.gain else 1.0 - share)
                    for t in evaluation.terms
                ]
            )
            self.rate -= soft * unfed
        elif self.braking.jerks and self.yielding.still:
            v_previous = evaluation.v_previous[self._dofs]
            qp.g += pulled[:, 0] - qp.H @ self.braking.followed(share * v, slope, v_previous, dt)
        else:
            qp.g += (1.0 - share) * pulled[:, 0]

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
        mujoco.mj_fullM(evaluation.model, evaluation.data, self.inertia)
        matrix = self.inertia if self._all else self.inertia[np.ix_(self._dofs, self._dofs)]
        self.qp.H += self.unit * self._problem.inertia * matrix

    def add_mink_tasks(self, dt: float) -> None:
        """Add mink's tasks, whose variable is Δq = v dt: divided by dt², W Δq ≈ r is W v ≈ r/dt."""
        for task in self._problem.mink_tasks:
            self._evaluation.attempt(type(task).__name__, self._add_mink_task, task, dt)

    def _add_mink_task(self, task: BaseTask, dt: float) -> None:
        qp, dofs, nv = self.qp, self._dofs, self._problem.model.nv
        configuration = self._evaluation.configuration
        residual = task.compute_qp_residual(configuration)
        if residual is None:
            objective = task.compute_qp_objective(configuration)
            h, c = parts("objective", objective, ("H", "c"))
            hessian, gradient = checked("H", h, (nv, nv)), checked("c", c, (nv,))
            qp.H += self.unit * hessian[np.ix_(dofs, dofs)]
            qp.g += self.unit * gradient[dofs] / dt
            return
        jacobian, error, damping = unpacked("residual", residual, 3)
        columns = checked("J", jacobian, (None, nv))[:, dofs]
        wanted, mu = checked("e", error, (len(columns),)), checked("damping", damping, ())
        qp.H += self.unit * columns.T @ columns
        qp.H.flat[:: dofs.size + 1] += self.unit * mu
        qp.g -= self.unit * wanted @ columns / dt

    def metric(self) -> Array:
        """Return A (n, n) at the present assembly, in the configuration's own unit."""
        chosen = np.ix_(self._dofs, self._dofs)
        metric = self._problem.metric[chosen]
        if self._problem.inertia:
            metric = metric + self._problem.inertia * self.inertia[chosen]
        return metric

    def levels(self, directed: bool = True) -> list[Level]:
        """Return what each level asks for at the present assembly, the highest first.

        What preserves its direction is a cost like any other where it is not to be `directed`.

        Before them come hard tasks that are a cost at this step. Last comes what picks among equal
        motions: A, or the least norm.
        """
        n = self._dofs.size
        damping = max(self.unit * self.adaptive.square, LEAST_DAMPING) * np.eye(n)
        metric = self.unit * self.metric()
        metric = metric + damping if metric.any() else np.eye(n)
        weighted, wanted = self._weigh(), -self._weigh_rate()
        return [
            *([self.yielding.level(damping)] if self.yielding.softened else []),
            *(
                self._level(level, weighted, wanted, damping, directed)
                for level in self.leveled_terms
            ),
            Level(np.zeros((0, n)), np.zeros(0), metric),
        ]

    def _level(
        self, terms: list[Term], weighted: Array, wanted: Array, damping: Array, directed: bool
    ) -> Level:
        """Return what terms ask for, out of W and S ẋ of all of them."""
        rows, rates, directions = [], [], []
        for term in terms:
            part = self._evaluation.rows_of([term])
            if term.joint:
                root = self.yielding.root(term)
                rows.append(root[:, self._dofs])
                rates.append(root @ self.rate[part])
                continue
            rows.append(weighted[part][:, self._dofs])
            rates.append(wanted[part])
            if term.preserve:
                weighed = term.diagonal > 0.0
                jacobian = self._evaluation.jacobian[part][weighed]
                directions.append((jacobian[:, self._dofs], self.rate[part][weighed]))
        for level, curvature in self.curvature.levels.items():
            if level <= terms[0].level:
                damping = damping + np.diag(curvature)
        direction = None
        if directions and directed:
            jacobians, asked = zip(*directions, strict=True)
            direction = (np.vstack(jacobians), np.concatenate(asked))
        elif directions:
            preserved = [term for term in terms if term in self.curvature.exact]
            damping = damping + self.yielding.bound(preserved)
        return Level(np.vstack(rows), np.concatenate(rates), damping, direction)

    def equalities(self) -> Equalities | None:
        """Return what the hard tasks ask for at the present assembly; None without any.

        Near a singularity those that bend are a cost instead, above all others and with their X.
        """
        held = self.yielding.held(self.qp.lb)
        if self.yielding.softened and not self._problem.cascaded:
            level = self.yielding.level(np.zeros_like(self.qp.H))
            share = self._problem.soft_ratio
            self.qp.H += (level.rows.T @ level.rows + level.metric) / share
            self.qp.g -= level.rate @ level.rows / share
        return held

    @property
    def damping(self) -> float:
        """λ of the last assembly."""
        return math.sqrt(self.adaptive.square)

    @property
    def damped(self) -> bool:
        """Whether λ of the last assembly was above its floor."""
        return self.adaptive.raised

    def sigma_min(self) -> float:
        """Return σ, the least singular value of the tasked rows (see `Damping`); NaN without any.

        A task that leaves dofs free is not singular for it.
        """
        self._weigh()
        sigma = self.adaptive.singular_values()
        return float(sigma[-1]) if sigma.size else math.nan

    def resize(self, rows: int, equalities: int) -> None:
        """Give the program another number of rows and equalities: one kept from an earlier step.

        All of them have the same cost and the same box.
        """
        shape = (rows, equalities)
        if shape not in self._programs:
            self._programs[shape] = QP(self._dofs.size, *shape, cost=self.qp)
        self.qp = self._programs[shape]
