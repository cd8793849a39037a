"""The native engine: the step in C++, in the arrays of the Python engine that it stands in for."""

import ctypes
import math
import os
from functools import cache
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.config.solvers import AUTO, DEFAULT
from rmrc.engine.python import PythonEngine
from rmrc.errors import SolverError
from rmrc.limits.tendon import TendonRanges
from rmrc.model.extents import dofs_of_bodies
from rmrc.model.frames import FrameHandle
from rmrc.native import kinematics as native_kinematics
from rmrc.native.layout import Layout
from rmrc.native.levels import HeldRows, LoopParts, descend, has_evaluator, hold
from rmrc.native.rows import NativeRows, NativeShortening
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.qp.backends import Backend, create
from rmrc.qp.backends.native import MOST_CHANGES, Native
from rmrc.qp.program import KKT, Solution, SolveStatus
from rmrc.qp.rows import Rows
from rmrc.tasks.axis_align import AxisAlignTerm
from rmrc.tasks.base import Term, square_root
from rmrc.tasks.centering import CenteringTerm
from rmrc.tasks.com import ComTerm
from rmrc.tasks.coupling import CouplingTerm
from rmrc.tasks.frame import FrameTerm
from rmrc.tasks.look_at import LookAtTerm
from rmrc.tasks.loop import LoopTerm
from rmrc.tasks.posture import PostureTerm
from rmrc.tasks.relative_frame import RelativeFrameTerm
from rmrc.tasks.smooth import SmoothTerm
from rmrc.tasks.velocity import VelocityTerm

Array = NDArray[np.float64]

FUNCTIONS = (
    "mj_kinematics",
    "mj_comPos",
    "mj_makeM",
    "mj_fullM",
    "mj_integratePos",
    "mj_differentiatePos",
    "mj_geomDistance",
)
"""What the step calls of libmujoco, in the order in which the extension takes the addresses."""
SINGULAR = 1e-13
"""Share of the largest weight below which a weight of all motions is lost in rounding."""

_JOINT = {
    PostureTerm: "posture",
    CenteringTerm: "posture",
    VelocityTerm: "velocity",
    SmoothTerm: "smooth",
}
_ROWS = (FrameTerm, RelativeFrameTerm, LookAtTerm, AxisAlignTerm, ComTerm, CouplingTerm)
_NONE = np.zeros(0)


@cache
def addresses() -> tuple[int, ...]:
    """Return where the functions of the libmujoco stand that the Python package has loaded.

    Raises:
        SolverError: If the package's library is not found.
    """
    folder = Path(mujoco.__file__).parent
    files = [path for name in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll")
             for path in folder.glob(name)]  # fmt: skip
    # The library that is there already, never a second one.
    mode = getattr(os, "RTLD_NOLOAD", 0) | getattr(os, "RTLD_NOW", 0)
    for path in files:
        try:
            library = ctypes.CDLL(str(path), mode=mode)
            found = [ctypes.cast(getattr(library, name), ctypes.c_void_p) for name in FUNCTIONS]
        except (OSError, AttributeError):
            continue
        return tuple(pointer.value or 0 for pointer in found)
    raise SolverError(f"no library of MuJoCo's with {', '.join(FUNCTIONS)} is in {folder}")


def lacking(problem: Problem) -> list[str]:
    """Return what of a problem the native engine has no place for."""
    config, found = problem.config, []
    if config.method != "qp":
        found.append(f"method {config.method}")
    # The programs of a cascade have a damping of their own.
    if not (problem.cascaded or _definite(problem)):
        found.append("programs without damping")
    if config.solver.backend == AUTO and config.solver.tolerance is not None:
        found.append("tolerance of a backend's")
    if any(isinstance(limit, TendonRanges) and not limit.fixed for limit in problem.barriers):
        found.append("range of a tendon with a path in space")
    return found


def _definite(problem: Problem) -> bool:
    """Return whether λ, the metric and the terms on the joints weigh every motion."""
    if problem.inertia > 0.0:
        return True
    constant = problem.metric + problem.damping**2 * np.eye(problem.model.nv)
    largest = constant.max()
    for term in problem.terms:
        if not term.rows or term.hard:
            continue
        weight = term.weight * problem.soft_ratio**term.level
        largest = max(largest, weight.max())
        if term.joint:
            constant = constant + (np.diag(weight) if weight.ndim == 1 else weight)
    values = np.linalg.eigvalsh(constant[np.ix_(problem.dofs, problem.dofs)])
    return bool(values[0] > SINGULAR * largest)


class NativeEngine(PythonEngine):
    """Evaluates, assembles and solves in C++, with an active-set method (see docs/native.md).

    Errors, feed-forwards, Jacobians, ẋ, the cost and the box are written where the Python engine
    would have written them. A step is C++'s as a whole, the correction and the shortening of its
    command and the rungs of the ladder included; with tasks and limits of mink's the steps are the
    Python engine's, and what they solve is solved in C++. Terms without an
    evaluator in C++, the foreign ones, are evaluated in Python before C++ assembles.
    """

    name = "native"
    _rows: NativeRows
    _shortening: NativeShortening | None

    def __init__(self, problem: Problem):
        self._named = problem.config.solver.backend != AUTO  # and so solves, in place of C++
        super().__init__(problem)
        if not self._named:
            self.backend = self.name
        self.behind = False
        """Whether the extension has taken a step whose rows have not been read."""
        model, data, evaluation = problem.model, self.evaluation.data, self.evaluation
        self._moves = dofs_of_bodies(model)
        self._moving = np.frombuffer(evaluation.moving, dtype=np.uint8)
        self._cdof = np.zeros((model.nv, 6))
        self._native = self._build()
        curvature = self._assembly.curvature
        self._ways = {term.name: curvature.joints(way) for term, way in curvature.ways.items()}
        self._exact = {t.name: square_root(mask) for t, mask in curvature.exact.items()}
        rows = _ROWS if not has_evaluator(model, evaluation.terms) else (*_ROWS, LoopTerm)
        watched = native_kinematics.of_step(problem, evaluation.terms, self._rows)
        self._native.follow(native_kinematics.build(model, data, self._cdof, watched))
        for term in evaluation.terms:
            self._add(term, rows)
        self._adapt()
        self._foreign = [
            (kind, evaluate)
            for kind, evaluate in evaluation.evaluators.items()
            if kind not in _JOINT and not issubclass(kind, rows)
        ]
        hard = any(term.hard for term in evaluation.terms)
        # Tasks and limits of mink's come behind what C++ has assembled, and so does a backend that
        # is named.
        self._alone = not (problem.mink_tasks or problem.mink_limits or self._named)
        self._held = hold(self._native, problem, evaluation) if hard else None
        if not self._box_alone:
            self._connect()
        if problem.cascaded:
            descend(self._native, problem, evaluation, self._assembly)
        self.layout = Layout(self)
        """Where the numbers of a step stand in what the extension has noted of it."""

    def _build(self) -> _native.Engine:
        """Return the extension's engine, in the arrays of this one."""
        problem, evaluation, assembly = self.problem, self.evaluation, self._assembly
        model, data, qp, box = problem.model, evaluation.data, assembly.qp, problem.box
        return _native.Engine(
            functions=addresses(),
            model=model,
            data=data,
            qpos=data.qpos,
            cdof=self._cdof,
            error=evaluation.error,
            feedforward=evaluation.feedforward,
            rate=assembly.rate,
            jacobian=evaluation.jacobian,
            v_previous=evaluation.v_previous,
            a_previous=evaluation.a_previous,
            dofs=problem.dofs.tolist(),
            hessian=assembly.constant.ravel().tolist(),
            unit=assembly.unit,
            share_of_inertia=problem.inertia,
            floor=problem.damping**2,
            least_curvature=assembly.curvature.least,
            brakes=problem.curvature,
            soft_ratio=problem.soft_ratio,
            limits=(
                box.coordinate.tolist(),
                box.lower.tolist(),
                box.upper.tolist(),
                box.gain,
                box.velocity.tolist(),
                box.acceleration.tolist(),
                box.jerk.tolist(),
                box.step.tolist(),
            ),
            H=qp.H,
            g=qp.g,
            added_damping=assembly.adaptive.added,
            inertia=assembly.inertia,
            lb=qp.lb,
            ub=qp.ub,
            max_iter=problem.config.solver.max_iter or MOST_CHANGES,
        )

    def _new_rows(self) -> NativeRows:
        return NativeRows(self.problem, self.evaluation)

    def _new_shortening(self) -> NativeShortening:
        return NativeShortening(self.problem, self.evaluation.obstacle_twist)

    def _connect(self) -> None:
        """Hand the rows to the extension, and what checks the commands where they lead."""
        rows, shortening = self._rows, self._shortening
        rows.connect(self._native, self._assembly.rate, self._cdof)
        if shortening is not None:
            shortening.connect(rows)
        if rows.any:
            self._native.limit(rows.native, None if shortening is None else shortening.native)

    def _add(self, term: Term, kinds: tuple[type[Term], ...]) -> None:
        """Hand a term to the extension, which evaluates those with rows that are of these kinds."""
        native, weight = self._native, self._assembly.leveled(term)
        if term.joint:
            kind = _JOINT.get(type(term), "foreign")
            wrapped = term.wrapped.tolist() if isinstance(term, PostureTerm) else []
            native.add_joint_task(self._rows_of(term, weight), kind, wrapped)
            return
        rows = self._rows_of(term, square_root(weight))
        match term:
            case FrameTerm():
                if term.axes == "world":
                    native.add_world_frame(rows, self._frame(term.frame))
                else:
                    native.add_frame(rows, self._frame(term.frame))
            case RelativeFrameTerm():
                native.add_relative(rows, self._frame(term.frame), self._frame(term.root))
            case LookAtTerm():
                native.add_axis(rows, self._frame(term.frame), term.axis.tolist(), True)
            case AxisAlignTerm():
                native.add_axis(rows, self._frame(term.frame), term.axis.tolist(), False)
            case ComTerm():
                native.add_com(rows, *self._masses(term))
            case CouplingTerm():
                by_coordinate, by_dof = term.by_coordinate.tolist(), term.by_dof.tolist()
                native.add_coupling(rows, by_coordinate, by_dof, term.offset)
            case LoopTerm() if LoopTerm in kinds:
                parts = LoopParts(self.evaluation, self._moves, term)
                scale, angular = term.scale.tolist(), term.angular.tolist()
                native.add_loop(rows, parts.pairs, parts.polynomials, scale, angular)
            case _:
                native.add_foreign(rows)

    def _rows_of(self, term: Term, root: Array) -> _native.TermRows:
        """Return what all terms have: `root` is S, or B of a term on the joints themselves."""
        evaluation, at = self.evaluation, self.evaluation.index[term.name]
        return _native.TermRows(
            first=evaluation.rows_of([term]).start,
            count=term.rows,
            gain=term.gain,
            root=root.ravel().tolist(),
            target=evaluation.target[term.name],
            twist=evaluation.twist[term.name],
            moving=self._moving[at : at + 1],
            clamps=[
                (first, last - first, longest)
                for part, longest in term.clamps
                for first, last, _ in (part.indices(term.rows),)
            ],
            way=self._ways.get(term.name, []),
            exact_root=self._exact[term.name].ravel().tolist() if term.name in self._exact else [],
        )

    def _frame(self, frame: FrameHandle) -> _native.Frame:
        return native_kinematics.frame_of(self.evaluation, self._moves, frame)

    def _masses(
        self, term: ComTerm
    ) -> tuple[
        list[tuple[int, float, Array, Array]], list[tuple[float, Array, Array, Array | None]]
    ]:
        """Return what each dof moves of the mass, and the subtrees with their shares.

        Of a subtree the origin of its root is there, too, and the twist of a mocap body under it.
        """
        model, data = self.problem.model, self.evaluation.data
        com = data.subtree_com
        moved = []
        for dof, body in enumerate(model.dof_bodyid.tolist()):
            for root, share in term.shares:
                if not share:
                    continue
                if body in self._ancestors(root):  # it moves all of the subtree
                    part, inner = root, share
                elif root in self._ancestors(body):
                    part = body
                    inner = share * model.body_subtreemass[body] / model.body_subtreemass[root]
                else:
                    continue
                moved.append((dof, float(inner), com[part], data.xpos[model.body_rootid[body]]))
        parts = []
        for root, share in term.shares:
            carrier = self.evaluation.carrier(root)
            twist = None if carrier is None else carrier.twist
            parts.append((share, com[root], data.xpos[model.body_rootid[root]], twist))
        return moved, parts

    def _ancestors(self, body: int) -> set[int]:
        """Return a body and those that it hangs on, but for the world."""
        found = set()
        while body:
            found.add(body)
            body = int(self.problem.model.body_parentid[body])
        return found

    def _adapt(self) -> None:
        """Hand the rule of the damping to the extension."""
        adaptive, damping = self._assembly.adaptive, self.problem.config.damping
        if not adaptive.adapts:
            return
        starts = [self.evaluation.rows_of([term]).start for term in self.evaluation.terms]
        rows = []
        for row in adaptive.rows.tolist():
            term = int(np.searchsorted(starts, row, side="right")) - 1
            rows.append((term, row - starts[term]))
        self._native.adapt(
            damping.adapt, damping.threshold, damping.largest, adaptive.rank, adaptive.scale, rows
        )

    def _evaluate(self, q: Array) -> None:
        """Evaluate all terms, the foreign ones after the others."""
        self._native.evaluate(q)
        self.evaluation.fill_constraints()
        self.evaluation.run(self._foreign)

    def _assemble(self, q: Array, dt: float) -> bool:
        self.behind = False
        self._evaluate(q)
        outside = self._native.assemble(dt)
        if self.evaluation.refused:
            self._assembly.rate[:] = 0.0
        else:
            self._assembly.add_mink_tasks(dt)
        return outside

    def _new_backend(self) -> Backend:
        if self._named:
            return super()._new_backend()
        return Native(self.problem.config.solver.max_iter)

    def _other_backend(self) -> Backend:
        if self._named:
            return super()._other_backend()
        return create(DEFAULT, max_iter=self.problem.config.solver.max_iter)

    def reset(self) -> None:
        """Forget the last solution, so that the next solve starts cold."""
        self._native.forget()
        super().reset()

    @property
    def native(self) -> _native.Engine:
        """The engine of the extension."""
        return self._native

    @property
    def steps_alone(self) -> bool:
        """Whether the extension can take a controller's common steps without Python."""
        problem = self.problem
        if not self._alone or self._foreign:
            return False
        timed = min(problem.target_timeout, problem.measurement_timeout) < math.inf
        measures = problem.config.previous == "measured" or problem.lag.any()
        return not (timed or measures or np.isfinite(problem.box.jerk).any())

    def solve(self, q: Array, v_previous: Array, dt: float) -> Solution:
        """Return the solution at q (nq,) for a step of dt seconds, or the brake."""
        if not self._alone:
            return super().solve(q, v_previous, dt)
        self.evaluation.v_previous[:] = v_previous
        if self._foreign:
            self._evaluate(q)
            if self.evaluation.refused:
                return super().solve(q, v_previous, dt)
        both = np.empty((2, self.problem.dofs.size))
        status, iterations, *kkt, self.outside, share, relaxed = self._native.solve(
            None if self._foreign else q, dt, self.deadline - perf_counter(), both
        )
        y = w = _NONE
        if not self._box_alone:
            y, w = self._catch_up()
            self.relaxed, self.share = relaxed, share
        if self._cascade is not None:
            self.scaled = _native.scaled(self._native)
        return Solution(both[0], both[1], y, w, iterations, SolveStatus(status), KKT(*kkt))

    def _catch_up(self) -> tuple[Array, Array]:
        """Have the rows and equalities of the last step where Python looks; return y and w."""
        self.behind = False
        held, y, moved = None, self._rows.read(), self._native.moved
        if self._held is not None:
            count = slice(_native.equalities(self._native))
            held = HeldRows(*(array[count].copy() for array in self._held))
        self._take_rows(held)
        qp = self._assembly.qp
        if moved is not None:
            qp.lo[:], qp.hi[:], qp.f[:] = moved
        if self._native.boxed:
            self._assembly.resize(0, 0)
        return y, _NONE if held is None else held.multiplier

    @property
    def assembly(self) -> Assembly:
        """The program of the last step."""
        if self.behind:
            self._catch_up()
        return self._assembly

    @property
    def rows(self) -> Rows:
        """The rows of the last step."""
        if self.behind:
            self._catch_up()
        return self._rows
