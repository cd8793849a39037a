"""The `loop` task: the equality constraints of the model itself, such as closed chains."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rmrc.model.carrier import Carrier
from rmrc.model.configuration import joint_type
from rmrc.model.frames import find
from rmrc.model.objects import bodies_of_equality
from rmrc.tasks.base import (
    Array,
    ConstraintTask,
    FieldError,
    Term,
    WeightedTask,
    weight_array,
)
from rmrc.text.annotations import NameOf

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

_CONNECT, _WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
_JOINT, _TENDON = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON
ROWS = {_CONNECT: 3, _WELD: 6, _JOINT: 1, _TENDON: 1}
"""Number of rows of each type of constraint."""
_DISABLED = mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
TORQUE_SCALE = 10
"""Where a weld has its `torquescale` among its data."""


class LoopTask(ConstraintTask, WeightedTask):
    """Hold equality constraints of the model: connect, weld, joint and tendon."""

    type: Literal["loop"] = "loop"
    equalities: (
        Annotated[tuple[Annotated[str, NameOf("equality")], ...], Field(min_length=1)] | None
    ) = None
    """The constraints that are meant; by default all that the model has active."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies that the constraints hold together, and of their joints and tendons."""
        return [body for i in self._found(model) for body in bodies_of_equality(model, i)]

    def compile(self, model: mujoco.MjModel, start: Array) -> "LoopTerm":
        """Find the constraints.

        Raises:
            FieldError: If there is none, or one is not active or of a flexible body.
        """
        return self.term(model, start, self._found(model))

    def term(self, model: mujoco.MjModel, start: Array, equalities: tuple[int, ...]) -> "LoopTerm":
        """Return the term of some constraints, by their ids."""
        scale, angular = zip(*(_true_units(model, i) for i in equalities), strict=True)
        return LoopTerm(
            **self.common(),
            weight=weight_array(self.B, sum(part.size for part in scale)),
            target=start[:0],
            equalities=equalities,
            scale=np.concatenate(scale),
            angular=np.concatenate(angular),
        )

    def _found(self, model: mujoco.MjModel) -> tuple[int, ...]:
        """Return the ids of the constraints that are meant."""
        if model.opt.disableflags & _DISABLED:
            raise FieldError("equalities", "the model's options disable its equality constraints")
        named = dict.fromkeys(find(model, "equality", name) for name in self.equalities or ())
        found = tuple(named) or tuple(np.flatnonzero(model.eq_active0).tolist())
        if not found:
            raise FieldError("equalities", "this model has no active equality constraint")
        for i in found:
            name = equality_name(model, i)
            if not model.eq_active0[i]:
                raise FieldError("equalities", f"'{name}' is not active: the model switches it off")
            if mujoco.mjtEq(int(model.eq_type[i])) not in ROWS:
                raise FieldError(
                    "equalities",
                    f"'{name}' is a constraint of a flexible body; connect, weld, joint and tendon "
                    "can be held: name those that are meant",
                )
        return found


def held_by_default(model: mujoco.MjModel) -> list[int]:
    """Return the ids of the active constraints that can be held: all but those of flexes."""
    if model.opt.disableflags & _DISABLED:
        return []
    return [
        i
        for i in np.flatnonzero(model.eq_active0).tolist()
        if mujoco.mjtEq(int(model.eq_type[i])) in ROWS
    ]


def equality_name(model: mujoco.MjModel, equality: int) -> str:
    """Return what a message calls an equality constraint."""
    return model.equality(equality).name or f"equality {equality}"


class End(NamedTuple):
    """An end of a connect or a weld: a point and a rotation that a body carries."""

    body: int
    point: Array
    """In the body's coordinates (3,)."""
    turn: Array
    """wxyz, in the body's coordinates (4,)."""


def ends_of_equality(model: mujoco.MjModel, equality: int) -> tuple[End, End]:
    """Return the ends of a connect or a weld."""
    numbers, unturned = model.eq_data[equality], np.array([1.0, 0.0, 0.0, 0.0])
    one, other = bodies_of_equality(model, equality)
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        return (
            End(one, model.site_pos[first], model.site_quat[first]),
            End(other, model.site_pos[second], model.site_quat[second]),
        )
    if int(model.eq_type[equality]) == int(_WELD):
        # Its anchor is the second body's, and the pose of that one in the first's.
        return End(one, numbers[3:6], numbers[6:10]), End(other, numbers[:3], unturned)
    return End(one, numbers[:3], unturned), End(other, numbers[3:6], unturned)


def _true_units(model: mujoco.MjModel, i: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return what turns each residual of a constraint into m or rad, and which are angles."""
    kind = mujoco.mjtEq(int(model.eq_type[i]))
    scale, angular = np.ones(ROWS[kind]), np.zeros(ROWS[kind], dtype=bool)
    if kind == _WELD:  # its rotation is the vector part of a quaternion, times the torque scale
        torque_scale = model.eq_data[i, TORQUE_SCALE]
        scale[3:] = 2.0 / torque_scale if torque_scale else 0.0
        angular[3:] = True
    elif kind == _JOINT:
        angular[:] = _is_hinge(model, model.eq_obj1id[i])
    elif kind == _TENDON:
        tendon = model.eq_obj1id[i]
        first = model.tendon_adr[tendon]
        wraps = range(first, first + model.tendon_num[tendon])
        angular[:] = all(
            model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT
            and _is_hinge(model, model.wrap_objid[w])
            for w in wraps
        )
    return scale, angular


def _is_hinge(model: mujoco.MjModel, joint: int) -> bool:
    return joint_type(model, joint) == mujoco.mjtJoint.mjJNT_HINGE


@dataclass(frozen=True, eq=False, kw_only=True)
class LoopTerm(Term):
    """Rows of a `loop` task: e = −r(q) and J = ∂r/∂q for MuJoCo's own residuals r.

    A connect has 3 rows in m; a weld these and the vector part of its quaternion's error times
    `torquescale`; a joint and a tendon one each, y − y₀ − p(x − x₀) for the polynomial p.
    ẋ_ff = −∂r/∂t of the mocap bodies.
    """

    decisive: ClassVar[bool] = True

    equalities: tuple[int, ...]
    """Ids of the constraints, in the order of the rows."""
    scale: Array
    """What turns a residual (rows,) into m or rad, for small angles."""
    angular: NDArray[np.bool_]
    """The rows that are angles (rows,)."""

    @property
    def units(self) -> tuple[str, ...]:
        """The norm of the gaps and that of the angles, each where there are any."""
        return tuple(compress(("m", "rad"), self._kinds))

    @property
    def unit_rows(self) -> tuple[NDArray[np.intp], ...]:
        """Those of the gaps and those of the angles."""
        rows = np.flatnonzero(~self.angular), np.flatnonzero(self.angular)
        return tuple(compress(rows, self._kinds))

    @property
    def _kinds(self) -> tuple[bool, bool]:
        return (not self.angular.all(), bool(self.angular.any()))

    def measure(self, error: Array) -> Array:
        """Return the norm of the gaps in m and that of the angles in rad."""
        true = self.scale * error
        gaps, angles = true[~self.angular], true[self.angular]
        return np.sqrt([gaps @ gaps, angles @ angles])[list(self._kinds)]

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate all terms by one call of MuJoCo's."""
        return _LoopEvaluator([t for t in terms if isinstance(t, LoopTerm)], evaluation)


class _LoopEvaluator:
    """Reads residuals and Jacobians where MuJoCo makes the rows of its constraints.

    Equalities come first there, in the order of their ids; MuJoCo leaves out one that no joint
    moves, whose rows are then zero here.
    """

    def __init__(self, terms: Sequence[LoopTerm], evaluation: "Evaluation"):
        model = self._model = evaluation.model
        self._data = evaluation.data
        rows = evaluation.rows_of(terms)
        self._jacobian, self._error = evaluation.jacobian[rows], evaluation.error[rows]
        self._equalities = [i for term in terms for i in term.equalities]
        self._tendons = bool((model.eq_type[self._equalities] == _TENDON).any())
        self._sparse = bool(mujoco.mj_isSparse(model))
        self._feedforward = evaluation.feedforward[rows]
        self._carried = list(self._carried_pairs(evaluation))
        self._known = np.zeros(0, dtype=np.int32)
        self._locate(self._known)

    def _carried_pairs(self, evaluation: "Evaluation") -> Iterator["_CarriedPair"]:
        """Yield the connects and welds with an end that a mocap body carries."""
        first = 0
        for i in self._equalities:
            kind = mujoco.mjtEq(int(self._model.eq_type[i]))
            if kind in (_CONNECT, _WELD):
                ends = ends_of_equality(self._model, i)
                carriers = [evaluation.carrier(end.body) for end in ends]
                if any(carriers):
                    scale = float(self._model.eq_data[i, TORQUE_SCALE]) if kind == _WELD else None
                    yield _CarriedPair(first, ends, carriers, scale)
            first += ROWS[kind]

    def _locate(self, known: NDArray[np.int32]) -> None:
        """Find each row among MuJoCo's, for the ids that those have."""
        self._known, source = known.copy(), []
        first = {i: k for k, i in reversed(list(enumerate(known.tolist())))}
        for i in self._equalities:
            count = ROWS[mujoco.mjtEq(int(self._model.eq_type[i]))]
            source += range(first[i], first[i] + count) if i in first else [-1] * count
        self._source = np.array(source)
        self._absent = np.flatnonzero(self._source < 0)

    def __call__(self) -> None:
        model, data = self._model, self._data
        if self._tendons:
            mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)
        known = data.efc_id[: data.ne]
        if known.size != self._known.size or (known != self._known).any():
            self._locate(known)
        if known.size:
            np.take(self._rows(known.size), self._source, axis=0, out=self._jacobian)
            np.negative(data.efc_pos[self._source], out=self._error)
        for pair in self._carried:
            rate = pair.rate(data)
            self._feedforward[pair.first : pair.first + rate.size] = -rate
        self._jacobian[self._absent] = self._error[self._absent] = 0.0
        self._feedforward[self._absent] = 0.0

    def _rows(self, count: int) -> Array:
        """Return the Jacobian (count, nv) of the equalities."""
        model, data = self._model, self._data
        if not self._sparse:
            return data.efc_J[: count * model.nv].reshape(count, model.nv)
        dense = np.empty((count, model.nv))
        layout = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        mujoco.mju_sparse2dense(dense, data.efc_J, layout[0][:count], layout[1][:count], layout[2])
        return dense


class _CarriedPair(NamedTuple):
    """A connect or a weld, of which mocap bodies carry an end."""

    first: int
    """The first of its rows."""
    ends: tuple[End, End]
    carriers: Sequence[Carrier | None]
    torque_scale: float | None
    """None of a connect."""

    def rate(self, data: mujoco.MjData) -> Array:
        """Return ∂r/∂t (3,) or (6,), of r = [p₁ − p₂; s q₂* q₁] with s the torque scale.

        The rate of q₂* q₁ is ½ q₂* (ω₁ − ω₂) q₁.
        """
        twist, turned = np.zeros(6), np.zeros((2, 4))
        for k, (end, carrier) in enumerate(zip(self.ends, self.carriers, strict=True)):
            mujoco.mju_mulQuat(turned[k], data.xquat[end.body], end.turn)
            if carrier is not None:
                place = np.zeros(3)
                mujoco.mju_rotVecQuat(place, end.point, data.xquat[end.body])
                place += data.xpos[end.body]
                twist += (1.0, -1.0)[k] * carrier.velocity(place)
        if self.torque_scale is None:
            return twist[:3]
        back, half, rate = np.zeros((3, 4))
        mujoco.mju_negQuat(back, turned[1])
        mujoco.mju_mulQuat(half, back, np.array([0.0, *twist[3:]]))
        mujoco.mju_mulQuat(rate, half, turned[0])
        return np.concatenate([twist[:3], 0.5 * self.torque_scale * rate[1:]])
