"""The `clearance` task: the joints keep geoms away from one another, such as obstacles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Annotated, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rmrc.errors import ModelError, unknown_name
from rmrc.model.configuration import free_dofs
from rmrc.model.distance import is_capsule_and_box, signed_distance
from rmrc.model.frames import OBJECTS, in_subtree, names
from rmrc.model.objects import Objects
from rmrc.tasks.base import Array, FieldError, GainedTask, Term
from rmrc.tasks.manipulability import joint_dofs_above
from rmrc.text.annotations import NameOf
from rmrc.text.base import NonNegative, Positive, Subtree

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

TOUCHING = 1e-9
"""Two geoms this near to touching, in m, have no direction between their nearest points; such a
pair is left out of the step."""

Part = Annotated[str, NameOf("geom or body")] | Subtree


class ClearanceTask(GainedTask):
    """Keep pairs of geoms at a distance.

    Each pair of geoms with the signed distance d has a row

        e = (D − d)²/2D,  J = (1 − d/D) ∂d/∂q  where d < D, and both 0 elsewhere,

    so that J v = K e takes d back to D, (D − d)² falling as exp(−K t). As d passes D the row fades
    away; a pair that is farther apart leaves all motion to other tasks. A floating base is left
    alone.

    Source: Maciejewski and Klein 1985, Obstacle avoidance for kinematically redundant manipulators
    in dynamically varying environments.
    """

    type: Literal["clearance"] = "clearance"
    B: NonNegative = 1.0
    """Weight of each pair, a number."""
    pairs: Annotated[tuple[tuple[Part, Part], ...], Field(min_length=1)]
    """Pairs of geoms, bodies or subtrees, as {subtree: left_base}; a body, which goes before a geom
    of its name, means its geoms."""
    distance: Positive = 0.1
    """Distance D in m inside which a pair is pushed apart."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "ClearanceTerm":
        """Resolve the pairs.

        Raises:
            FieldError: If a body has no geoms, or no joint moves a pair relative to each other.
        """
        found: list[tuple[int, int]] = []
        for pair in self.pairs:
            first, second = (_geoms(model, part) for part in pair)
            moved = [
                (i, j)
                for i, j in product(first, second)
                if np.setxor1d(_dofs_above(model, i), _dofs_above(model, j)).size
            ]
            if not moved:
                raise FieldError(
                    "pairs", f"no joint moves '{pair[0]}' and '{pair[1]}' relative to each other"
                )
            for i, j in moved:
                low, high = sorted((i, j), key=lambda geom: (model.geom_type[geom], geom))
                found.append((low, high))
        geoms = np.array(list(dict.fromkeys(found)), dtype=np.intp)
        return ClearanceTerm(
            **self.common(),
            weight=np.full(len(geoms), self.B),
            target=start[:0],
            geoms=geoms,
            distance=self.distance,
        )


def _dofs_above(model: mujoco.MjModel, geom: int) -> NDArray[np.intp]:
    return joint_dofs_above(model, int(model.geom_bodyid[geom]))


def _geoms(model: mujoco.MjModel, part: str | Subtree) -> list[int]:
    """Return the geoms that a name or a subtree means."""
    if isinstance(part, Subtree):
        bodies = in_subtree(model, part)
    else:
        body = mujoco.mj_name2id(model, OBJECTS["body"], part)
        if body < 0:
            geom = mujoco.mj_name2id(model, OBJECTS["geom"], part)
            if geom < 0:
                known = [*names(model, "geom"), *names(model, "body")]
                raise ModelError(unknown_name("geom or body", part, dict.fromkeys(known)))
            return [geom]
        bodies = np.arange(model.nbody) == body
    geoms = np.flatnonzero(bodies[model.geom_bodyid]).tolist()
    if not geoms:
        what = f"the body '{part}'" if isinstance(part, str) else part
        raise FieldError("pairs", f"{what} has no geoms")
    return geoms


@dataclass(frozen=True, eq=False, kw_only=True)
class ClearanceTerm(Term):
    """Rows of a `clearance` task: e = (D − d)²/2D, J = (1 − d/D) ∂d/∂q of each pair inside D.

    ẋ_ff = −(1 − d/D) ∂d/∂t of the mocap bodies.
    """

    geoms: NDArray[np.intp]
    """The pairs of geoms (p, 2), each in the order of their types."""
    distance: float
    """D, m."""

    def without(self, objects: Objects, start: Array) -> "ClearanceTerm":
        """Return the term with the pairs that the robot moves relative to each other.

        Raises:
            FieldError: If there is none.
        """
        model, moved = objects.model, []
        for one, other in model.geom_bodyid[self.geoms].tolist():
            dofs = np.setxor1d(joint_dofs_above(model, one), joint_dofs_above(model, other))
            moved.append(bool((~objects.dofs[dofs]).any()))
        if all(moved):
            return self
        if not any(moved):
            raise FieldError("pairs", "the robot moves none of them: they are objects or fixed")
        return replace(self, geoms=self.geoms[moved], weight=self.weight[moved])

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one."""
        fields = [_Field(term, evaluation) for term in terms if isinstance(term, ClearanceTerm)]

        def evaluate() -> None:
            for field in fields:
                field()

        return evaluate


class _Field:
    """Evaluates one `clearance` term: pairs whose bounding spheres are apart cost next to nothing.

    For the nearest points a and b of a pair, with b − a = d n, ∂d/∂q = nᵀ (J_b − J_a), also where
    the geoms overlap and d is negative.
    """

    def __init__(self, term: ClearanceTerm, evaluation: "Evaluation"):
        model = self._model = evaluation.model
        self._data, self._term = evaluation.data, term
        rows = evaluation.rows_of([term])
        self._error, self._jacobian = evaluation.error[rows], evaluation.jacobian[rows]
        self._feedforward = evaluation.feedforward[rows]
        self._pairs = [(a, b, is_capsule_and_box(model, a, b)) for a, b in term.geoms.tolist()]
        self._bodies = model.geom_bodyid[term.geoms].tolist()
        self._carriers = [[evaluation.carrier(body) for body in pair] for pair in self._bodies]
        self._base = free_dofs(model)
        radii = model.geom_rbound[term.geoms]
        near = radii.sum(axis=1) + term.distance
        self._near_square = np.where(radii.all(axis=1), near, np.inf) ** 2  # a plane's radius is 0
        self._segment = np.empty(6)
        self._first, self._second = np.zeros((2, 3, model.nv))

    def __call__(self) -> None:
        self._error[:], self._jacobian[:], self._feedforward[:] = 0.0, 0.0, 0.0
        centres = self._data.geom_xpos[self._term.geoms]
        apart = centres[:, 1] - centres[:, 0]
        for k in np.flatnonzero(np.einsum("ki,ki->k", apart, apart) < self._near_square).tolist():
            self._set(k)

    def _set(self, k: int) -> None:
        """Set the row of pair k, if it is inside D."""
        model, data, segment = self._model, self._data, self._segment
        d = signed_distance(model, data, self._pairs[k], self._term.distance, segment)
        if d >= self._term.distance or abs(d) < TOUCHING:
            return
        a, b = segment[:3], segment[3:]
        mujoco.mj_jac(model, data, self._first, None, a, self._bodies[k][0])
        mujoco.mj_jac(model, data, self._second, None, b, self._bodies[k][1])
        share = 1.0 - d / self._term.distance
        self._error[k] = 0.5 * share * (self._term.distance - d)
        outward = (share / d) * (b - a)
        self._jacobian[k] = outward @ (self._second - self._first)
        self._jacobian[k, self._base] = 0.0
        for sign, point, carrier in zip((1.0, -1.0), (a, b), self._carriers[k], strict=True):
            if carrier is not None:
                self._feedforward[k] += sign * (outward @ carrier.velocity(point)[:3])
