"""The equalities E v = f of a step: what the hard tasks ask for, in independent rows."""

import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.tasks.base import Term

Array = NDArray[np.float64]

RANK = 1e-6
"""A singular value up to this share of the largest of 1 and σ_max counts as zero. A joint speed of
1 rad/s along its direction moves the rows by less than the certificate's tolerance, and E v = f is
there no demand that a solver's answer could be held to."""
SPAN = 1e-9
"""An eigenvalue of a weight matrix up to this share of the largest counts as zero."""


def weighed_directions(weight: Array) -> Array:
    """Return orthonormal rows (r, m) that span the directions of a weight, (m,) or (m, m)."""
    if weight.ndim == 1:
        return np.eye(weight.size)[weight > 0.0]
    values, vectors = np.linalg.eigh(weight)
    return np.ascontiguousarray(vectors[:, values > SPAN * max(values[-1], 0.0)].T)


class Held(Protocol):
    """E v = f, wherever it was found."""

    @property
    def matrix(self) -> Array:
        """E (r, n)."""
        ...

    @property
    def right(self) -> Array:
        """f (r,)."""
        ...


class Equalities:
    """Stacks J v = ẋ of the hard tasks, and takes out what is redundant.

    With the singular value decomposition of the stack, J = U Σ Vᵀ, the rows handed on are
    E = U_rᵀ J and f = U_rᵀ ẋ for the r singular values that are not zero: of rows that contradict
    one another they are the least-squares compromise, in the rows' own units. A weight only tells
    which directions of a task are meant. The columns of joints that are to stand still are zero;
    what they move while they brake to rest is taken off ẋ.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation, terms: Iterable[Term]):
        self._evaluation, self._dofs = evaluation, problem.dofs
        self._all = problem.dofs.size == problem.model.nv
        self._still = np.flatnonzero(problem.box.velocity == 0.0)
        self._entries = []
        first = 0
        for term in terms:
            directions = weighed_directions(term.weight)
            rows = slice(first, first + len(directions))
            self._entries.append((term, evaluation.rows_of([term]), directions, rows))
            first = rows.stop
        self._stack, self._rate = np.zeros((first, problem.dofs.size)), np.zeros(first)
        for term, _, directions, rows in self._entries:
            if term.joint:
                self._stack[rows] = directions[:, problem.dofs]
        self.matrix = np.zeros((0, problem.dofs.size))
        """E (r, n)."""
        self.right = np.zeros(0)
        """f (r,)."""
        self.inconsistency = 0.0
        """‖(I − U_r U_rᵀ) ẋ‖: what no v gives, for rows contradict one another or reach nothing."""
        self.least_norm = np.zeros(problem.dofs.size)
        """The shortest v (n,) with E v = f."""

    def update(self, rate: Array, lower: Array) -> None:
        """Find E and f at the present evaluation for ẋ of all terms, and the lower bounds lb (n,).

        Of a joint that is to stand still lb is ub.
        """
        evaluation, stack = self._evaluation, self._stack
        for term, part, directions, rows in self._entries:
            if not term.joint:
                jacobian = evaluation.jacobian[part]
                directions.dot(jacobian if self._all else jacobian[:, self._dofs], stack[rows])
            wanted = term.attainable(evaluation.error[part], rate[part])
            directions.dot(wanted, self._rate[rows])
        if self._still.size:
            self._rate -= stack[:, self._still] @ lower[self._still]
            stack[:, self._still] = 0.0
        try:
            left, sigma, _ = np.linalg.svd(stack, full_matrices=False)
        except np.linalg.LinAlgError:  # not finite: the program itself says so
            self.matrix, self.right = stack, self._rate
            return
        rank = np.count_nonzero(sigma > RANK * sigma.max(initial=1.0))
        left = left[:, :rank]
        self.matrix = left.T @ stack
        self.right = self._rate @ left
        missed = self._rate - left @ self.right
        self.inconsistency = math.sqrt(missed.dot(missed))
        self.least_norm = self.matrix.T @ (self.right / sigma[:rank] ** 2)
