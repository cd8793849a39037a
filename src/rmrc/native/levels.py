"""Hard tasks, `loop` tasks and levels in C++: what the extension needs to know of them."""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.model.frames import FrameHandle
from rmrc.native.kinematics import frame_of
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.qp.equalities import weighed_directions
from rmrc.tasks.base import Term
from rmrc.tasks.loop import ROWS, TORQUE_SCALE, End, LoopTerm, ends_of_equality
from rmrc.tasks.pointing import PointingTerm

Array = NDArray[np.float64]

_CONNECT, _WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
_TENDON = mujoco.mjtEq.mjEQ_TENDON

Anchorage = tuple[_native.Frame, Array, list[float], list[float]]
"""A body's frame and quaternion, and a point and a rotation in its coordinates."""
Pair = tuple[int, bool, float, Anchorage, Anchorage]
"""The first row of a connect or a weld, whether it is a weld, its torque scale, and its ends."""
Combination = tuple[list[tuple[int, int, float]], float]
"""Coordinates, dofs and coefficients of a sum, and what it counts from."""
Polynomial = tuple[int, Combination, Combination, list[float]]
"""The row of y − p(x), with y, x and the coefficients of p."""


def has_evaluator(model: mujoco.MjModel, terms: Iterable[Term]) -> bool:
    """Return whether C++ can evaluate all `loop` terms: not where a tendon has a path in space."""
    for term in terms:
        if not isinstance(term, LoopTerm):
            continue
        for i in term.equalities:
            tendons = [t for t in (model.eq_obj1id[i], model.eq_obj2id[i]) if t >= 0]
            if _kind(model, i) == _TENDON and not all(_is_fixed(model, t) for t in tendons):
                return False
    return True


def _kind(model: mujoco.MjModel, equality: int) -> mujoco.mjtEq:
    return mujoco.mjtEq(int(model.eq_type[equality]))


def _wraps(model: mujoco.MjModel, tendon: int) -> range:
    first = model.tendon_adr[tendon]
    return range(first, first + model.tendon_num[tendon])


def _is_fixed(model: mujoco.MjModel, tendon: int) -> bool:
    kinds = model.wrap_type[_wraps(model, tendon)]
    return bool((kinds == mujoco.mjtWrap.mjWRAP_JOINT).all())


class LoopParts:
    """The constraints of a `loop` term, as the extension takes them."""

    def __init__(self, evaluation: Evaluation, moves: NDArray[np.bool_], term: LoopTerm):
        model = self._model = evaluation.model
        self._evaluation, self._moves = evaluation, moves
        self.pairs: list[Pair] = []
        """Connects and welds."""
        self.polynomials: list[Polynomial] = []
        """Joints and tendons."""
        first = 0
        for i in term.equalities:
            if _kind(model, i) in (_CONNECT, _WELD):
                self.pairs.append(self._pair(i, first))
            else:
                y, x = (self._combination(i, j) for j in (model.eq_obj1id[i], model.eq_obj2id[i]))
                self.polynomials.append((first, y, x, model.eq_data[i, :5].tolist()))
            first += ROWS[_kind(model, i)]

    def _pair(self, i: int, first: int) -> Pair:
        welded = _kind(self._model, i) == _WELD
        scale = float(self._model.eq_data[i, TORQUE_SCALE]) if welded else 1.0
        one, other = (self._anchorage(end) for end in ends_of_equality(self._model, i))
        return first, welded, scale, one, other

    def _anchorage(self, end: End) -> Anchorage:
        frame = frame_of(self._evaluation, self._moves, FrameHandle("body", end.body))
        quaternion = self._evaluation.data.xquat[end.body]
        return frame, quaternion, end.point.tolist(), end.turn.tolist()

    def _combination(self, i: int, which: int) -> Combination:
        """Return the sum that a joint or a fixed tendon is; one of nothing where there is none."""
        model = self._model
        if which < 0:
            return [], 0.0
        if _kind(model, i) == _TENDON:
            parts = [(model.wrap_objid[w], model.wrap_prm[w]) for w in _wraps(model, which)]
            reference = model.tendon_length0[which]
        else:
            parts, reference = [(which, 1.0)], model.qpos0[model.jnt_qposadr[which]]
        return [
            (int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint]), float(coefficient))
            for joint, coefficient in parts
        ], float(reference)


class HeldRows(NamedTuple):
    """E v = f of the hard tasks, where the extension writes it."""

    matrix: Array
    """E (capacity, n)."""
    right: Array
    """f (capacity,)."""
    multiplier: Array
    """w (capacity,)."""


def hold(native: _native.Engine, problem: Problem, evaluation: Evaluation) -> HeldRows:
    """Hand the hard tasks over to the extension."""
    tasks, capacity = [], 0
    for term in evaluation.terms:
        if not term.hard:
            continue
        directions = weighed_directions(term.weight)
        capacity += len(directions)
        axis = term.axis.tolist() if isinstance(term, PointingTerm) else []
        first = evaluation.rows_of([term]).start
        tasks.append((first, term.rows, directions.ravel().tolist(), term.joint, axis))
    n = problem.dofs.size
    rows = HeldRows(np.zeros((capacity, n)), np.zeros(capacity), np.zeros(capacity))
    still = (problem.box.velocity == 0.0).tolist()
    _native.hold(native, tasks, still, *rows)
    return rows


def descend(
    native: _native.Engine, problem: Problem, evaluation: Evaluation, made: Assembly
) -> None:
    """Hand the levels over to the extension."""
    places = {t.name: k for k, t in enumerate(t for t in evaluation.terms if not t.joint)}
    levels = []
    for terms in made.leveled_terms:
        parts, joints = [], []
        for term in terms:
            if term.joint:
                root = made.yielding.root(term).ravel().tolist()
                joints.append((evaluation.rows_of([term]).start, root))
            else:
                directed = np.flatnonzero(term.diagonal > 0.0).tolist() if term.preserve else []
                parts.append((places[term.name], directed))
        levels.append((parts, joints))
    metric = made.unit * problem.metric[np.ix_(problem.dofs, problem.dofs)]
    _native.descend(native, levels, metric.ravel().tolist(), made.unit * problem.inertia)
