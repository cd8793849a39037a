"""The rows of a step in C++, and the check of a command where it leads, as parts of the engine."""

from collections.abc import Iterator
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.engine.backtracking import Shortening
from rmrc.limits.ball import BallRange
from rmrc.limits.barrier import Barrier, Near
from rmrc.limits.collision import Collision
from rmrc.limits.tendon import TendonRange, described
from rmrc.limits.workspace import Workspace
from rmrc.model.configuration import turning_dofs
from rmrc.model.extents import dofs_of_bodies
from rmrc.native import kinematics as native_kinematics
from rmrc.qp.program import QP
from rmrc.qp.rows import Block, Rows

Array = NDArray[np.float64]

ARRAYS = (
    "qpos",
    "mocap_pos",
    "mocap_quat",
    "xpos",
    "xquat",
    "geom_xpos",
    "geom_xmat",
    "site_xpos",
)
"""What barriers read of an mjData."""


def kinematics(data: mujoco.MjData, cdof: Array) -> _native.Kinematics:
    """Return where the arrays of an mjData stand, and the axes of the dofs (nv, 6)."""
    arrays = {name: getattr(data, name) for name in ARRAYS} | {"cdof": cdof}
    return _native.Kinematics(data, arrays | {"reference": data.xpos})


class NativeRows(Rows):
    """Writes the rows in C++, but for those of mink's limits, with the state of the barriers."""

    def connect(self, engine: _native.Engine, rate: Array, cdof: Array) -> None:
        """Hand the barriers and the speeds to the extension; `rate` is ẋ of all terms.

        `cdof` are the axes of the dofs, each at the origin of its root.
        """
        problem, evaluation = self._problem, self._evaluation
        model, n = problem.model, problem.dofs.size
        sizes = [barrier.size + barrier.most_kept for barrier in self.barriers]
        capacity = self.speed_count + sum(sizes)
        self._matrix, self._slope = np.zeros((capacity, n)), np.zeros((capacity, model.nv))
        self._limits, self._ids = np.zeros((2, capacity)), np.zeros(capacity, dtype=np.intp)
        self._distance, self._drift, self._multiplier = np.zeros((3, capacity))
        self.native = _native.Rows(
            engine=engine,
            now=kinematics(evaluation.data, cdof),
            matrix=self._matrix,
            lower=self._limits[0],
            upper=self._limits[1],
            multiplier=self._multiplier,
            ids=self._ids,
            distance=self._distance,
            slope=self._slope,
            drift=self._drift,
        )
        self.native.know(
            resolution=problem.resolution,
            turning=turning_dofs(model).tolist(),
            slides=self._slides.described(),
            twist=evaluation.obstacle_twist,
        )
        self._moves = dofs_of_bodies(model)
        self._hand_over_speeds(rate)
        for barrier in self.barriers:
            self._hand_over(barrier)

    def _hand_over_speeds(self, rate: Array) -> None:
        model, data = self._problem.model, self._evaluation.data
        for speed, part in self._speeds:
            limit, frame = speed.limit, speed.limit.frame
            body = frame.body(model)
            position, rotation = frame.views(data)
            self.native.add_speed(
                position=position,
                rotation=rotation,
                reference=data.xpos[model.body_rootid[body]],
                dofs=self._moves[body].nonzero()[0].tolist(),
                turned=limit.turned,
                linear=limit.linear,
                angular=limit.angular,
                rate=rate[part],
            )

    def _hand_over(self, barrier: Barrier) -> None:
        native, twist = self.native, self._evaluation.obstacle_twist
        match barrier:
            case Collision(spec=spec):
                native.add_collision(
                    d_min=spec.d_min,
                    detect=spec.detect,
                    gain=spec.gain,
                    push=spec.push,
                    twist=twist,
                    arrays=barrier.arrays(),
                )
            case Workspace():
                planes = list(self._planes(barrier))
                native.add_workspace(planes, barrier.gain, barrier.push, twist)
            case BallRange(spec=spec):
                model = self._problem.model
                first, dof = model.jnt_qposadr[spec.joints], model.jnt_dofadr[spec.joints]
                balls = list(zip(first.tolist(), dof.tolist(), spec.largest.tolist(), strict=True))
                native.add_balls(balls, barrier.gain, barrier.push)
            case TendonRange(spec=spec):
                ends = described(self._problem.model, spec)
                native.add_tendons(ends, barrier.gain, barrier.push)
            case _:
                raise TypeError(f"there is no {type(barrier).__name__} in C++")

    def _planes(
        self, barrier: Workspace
    ) -> Iterator[tuple[str, int, int, int, list[float], float, list[int], list[float]]]:
        """Return what the extension knows of the planes."""
        model = self._problem.model
        for plane, levers in zip(barrier.planes, barrier.levers.tolist(), strict=True):
            body = plane.frame.body(model)
            root = int(model.body_rootid[body])
            dofs = self._moves[body].nonzero()[0].tolist()
            mocap = int(model.body_mocapid[root])
            normal = plane.normal.tolist()
            yield plane.frame.kind, plane.frame.id, root, mocap, normal, plane.offset, dofs, levers

    def update(self, qp: QP, rate: Array, dt: float) -> None:
        """Write the rows at the present kinematics, and read them."""
        self.native.update(qp.lb, qp.ub, dt)
        self.read()
        first = 0
        for speed, part in self._speeds:  # which `cut` goes on from
            own = np.zeros((speed.count, self._problem.model.nv)), np.zeros(speed.count)
            speed.write(self._problem.model, self._evaluation.v_previous, rate[part], *own)
            rows = slice(first, first + speed.count)
            self.matrix[rows], self.upper[rows] = own[0][:, self._problem.dofs], own[1]
            first += speed.count
        mink_rows = self._mink_rows(dt)
        if mink_rows:
            rows, upper = (np.concatenate(parts) for parts in zip(*mink_rows, strict=True))
            self.matrix = np.concatenate([self.matrix, rows])
            self.lower = np.concatenate([self.lower, np.full(upper.size, -np.inf)])
            self.upper = np.concatenate([self.upper, upper])
            self.count += upper.size

    def read(self) -> Array:
        """Take over what the extension has written last; return the multipliers (count,)."""
        native = self.native
        self.count, self.passed = native.count, native.passed
        rows = slice(self.count)
        self.matrix, limits = self._matrix[rows].copy(), self._limits[:, rows].copy()
        self.lower, self.upper = limits
        self.blocks = list(self._read_blocks(native.blocks))
        self.kept_blocks = list(self._read_blocks(native.kept_blocks))
        return self._multiplier[: self.count].copy()

    def _read_blocks(self, places: list[tuple[int, int]]) -> Iterator[Block]:
        for barrier, (first, count) in zip(self.barriers, places, strict=True):
            if count:
                rows = slice(first, first + count)
                near = Near(
                    self._ids[rows].copy(),
                    self._distance[rows].copy(),
                    self._slope[rows].copy(),
                    self._drift[rows].copy(),
                )
                yield Block(barrier, near, rows)


class NativeShortening(Shortening):
    """Has the extension find the share of a command."""

    def connect(self, rows: NativeRows) -> None:
        """Have the rows of an engine checked."""
        cdof = np.zeros((self._model.nv, 6))
        self.native = _native.Shortening(
            rows=rows.native,
            own=kinematics(self._data, cdof),
            twist=self._twist,
        )
        watched = native_kinematics.of_barriers(rows.barriers)
        self.native.follow(native_kinematics.build(self._model, self._data, cdof, watched))

    def share(
        self, data: mujoco.MjData, v: Array, brake: Array, blocks: list[Block], dt: float
    ) -> tuple[float, bool]:
        """Return s, and whether a distance falls below its limit even so."""
        return self.native.share(v, brake, dt, self.deadline - perf_counter())
