"""The `clearance` task: the joints keep geoms away from one another, such as obstacles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rmrc.config.base import NameOf, NonNegative, Positive
from rmrc.errors import ModelError, unknown_name
from rmrc.problem.frames import OBJECTS, names
from rmrc.problem.tasks.base import Array, FieldError, Gain, GainedTask, Term, gain_value
from rmrc.problem.tasks.manipulability import joint_dofs_above

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

# Two geoms this near to touching, in m, have no direction between their nearest points; such a
# pair is left out of the step.
TOUCHING = 1e-9

GeomOrBody = Annotated[str, NameOf("geom or body")]


class ClearanceTask(GainedTask):
    """Keep pairs of geoms at a distance.

    It descends U = ½ Σ (max(0, D − d)/ℓ)² for the signed distance d of each pair of geoms and its
    lever ℓ in m/rad, a bound of ‖∂d/∂q‖ by the lengths of the links: ẋ = −K ∇U, with which one
    pair inside D moves apart at K (D − d) ‖∂d/∂q‖²/ℓ², no faster than exp(−K t) would have it.
    Where no pair is inside D the task asks the joints that move its pairs for rest. A floating
    base is left alone.

    Source: Khatib 1986, Real-time obstacle avoidance for manipulators and mobile robots.
    """

    type: Literal["clearance"] = "clearance"
    B: NonNegative = 1.0
    """Weight of the squared difference from the wanted joint rates, a number."""
    pairs: Annotated[tuple[tuple[GeomOrBody, GeomOrBody], ...], Field(min_length=1)]
    """Pairs of geoms or bodies; a body, which goes before a geom of its name, means its geoms."""
    distance: Positive = 0.1
    """Distance D in m inside which a pair is pushed apart."""
    gain: Gain = 50.0
    """Gain K in 1/s, never above 1/dt: a bound of the rate, which is often a tenth of it."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "ClearanceTerm":
        """Resolve the pairs and the joints that move them.

        Raises:
            FieldError: If a body has no geoms, or no joint moves a pair relative to each other.
        """
        levers: dict[tuple[int, int], float] = {}
        moving: set[int] = set()
        for pair in self.pairs:
            (a, first), (b, second) = (_geoms(model, name) for name in pair)
            dofs = np.setxor1d(joint_dofs_above(model, a), joint_dofs_above(model, b))
            if not dofs.size:
                raise FieldError(
                    "pairs", f"no joint moves '{pair[0]}' and '{pair[1]}' relative to each other"
                )
            moving.update(dofs.tolist())
            for i, j in product(first, second):
                square = _lever_square(model, i, dofs) + _lever_square(model, j, dofs)
                levers[min(i, j), max(i, j)] = square
        weight, dofs = np.zeros(model.nv), np.array(sorted(moving), dtype=np.intp)
        weight[dofs] = self.B
        return ClearanceTerm(
            name=self.name,
            type=self.type,
            level=self.level,
            gain=gain_value(self.gain),
            weight=weight,
            target=start[:0],
            geoms=np.array(list(levers), dtype=np.intp),
            lever_square=np.array(list(levers.values())),
            distance=self.distance,
            dofs=dofs,
        )


def _geoms(model: mujoco.MjModel, name: str) -> tuple[int, list[int]]:
    """Return the body that a name stands for or is in, and the geoms that it means."""
    body = mujoco.mj_name2id(model, OBJECTS["body"], name)
    if body < 0:
        geom = mujoco.mj_name2id(model, OBJECTS["geom"], name)
        if geom < 0:
            known = [*names(model, "geom"), *names(model, "body")]
            raise ModelError(unknown_name("geom or body", name, dict.fromkeys(known)))
        return int(model.geom_bodyid[geom]), [geom]
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    if not count:
        raise FieldError("pairs", f"the body '{name}' has no geoms")
    return body, list(range(first, first + count))


def _lever_square(model: mujoco.MjModel, geom: int, dofs: NDArray[np.intp]) -> float:
    """Return Σ lever² in (m/rad)² over the dofs that move a geom.

    The lever of a rotation is the length of the chain from its joint to the farthest point of the
    geom; that of a slide is 1. The travel of slides in between is left out.
    """
    square, body = 0.0, int(model.geom_bodyid[geom])
    reach = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    while body:
        first = int(model.body_dofadr[body])
        for dof in np.intersect1d(dofs, range(first, first + int(model.body_dofnum[body]))):
            joint = model.dof_jntid[dof]
            slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            square += 1.0 if slide else (reach + float(np.linalg.norm(model.jnt_pos[joint]))) ** 2
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return square


@dataclass(frozen=True, eq=False, kw_only=True)
class ClearanceTerm(Term):
    """A `clearance` task: e = −∇U = Σ (max(0, D − d)/ℓ²) ∂d/∂q, J = I."""

    joint: ClassVar[bool] = True

    geoms: NDArray[np.intp]
    """The pairs of geoms (p, 2)."""
    lever_square: Array
    """ℓ² of each pair (p,), (m/rad)²."""
    distance: float
    """D, m."""
    dofs: NDArray[np.intp]
    """The dofs that move a pair relative to each other, without a floating base's."""

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

    For the nearest points a and b of a pair, with the normal n from the first geom to the second,
    ∂d/∂q = nᵀ (J_b − J_a). MuJoCo gives a and b with b − a = d n, also where the geoms overlap and
    d is negative.
    """

    def __init__(self, term: ClearanceTerm, evaluation: "Evaluation"):
        model = self._model = evaluation.model
        self._data, self._term = evaluation.data, term
        self._error = evaluation.error[evaluation.rows_of([term])]
        self._bodies = model.geom_bodyid[term.geoms]
        radii = model.geom_rbound[term.geoms]
        near = radii.sum(axis=1) + term.distance
        self._near_square = np.where(radii.all(axis=1), near, np.inf) ** 2  # a plane's radius is 0
        self._segment = np.empty(6)
        self._first, self._second = np.zeros((2, 3, model.nv))

    def __call__(self) -> None:
        self._error[self._term.dofs] = 0.0
        centres = self._data.geom_xpos[self._term.geoms]
        apart = centres[:, 1] - centres[:, 0]
        for k in np.flatnonzero(np.einsum("ki,ki->k", apart, apart) < self._near_square):
            self._add(k)

    def _add(self, k: np.intp) -> None:
        """Add the part of pair k."""
        model, data, term, segment = self._model, self._data, self._term, self._segment
        d = mujoco.mj_geomDistance(model, data, *term.geoms[k], term.distance, segment)
        if d >= term.distance or abs(d) < TOUCHING:
            return
        a, b = segment[:3], segment[3:]
        mujoco.mj_jac(model, data, self._first, None, a, self._bodies[k, 0])
        mujoco.mj_jac(model, data, self._second, None, b, self._bodies[k, 1])
        slope = (b - a) @ (self._second - self._first) / d  # ∂d/∂q
        strength = (term.distance - d) / term.lever_square[k]
        self._error[term.dofs] += strength * slope[term.dofs]
