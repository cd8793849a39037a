"""The rows lo ≤ C v ≤ hi of a step: barriers, speeds of frames, and limits of mink's."""

import math
from dataclasses import dataclass

import mink
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Evaluation
from rmrc.problem.limits.barrier import Barrier, Near
from rmrc.problem.limits.slides import Slides
from rmrc.problem.limits.speed import SpeedRows
from rmrc.problem.problem import Problem
from rmrc.qp.foreign import checked, parts
from rmrc.qp.program import QP

Array = NDArray[np.float64]

STOPPING = 0.5
"""Share of the deceleration along a barrier's slope that is counted on: the joints do not brake in
the proportions of the slope."""
ROUNDING = 1e-9
"""Share by which a row stays below the fastest that the box allows."""
FASTEST = 1e6
"""Rate in rad/s or m/s that stands for any."""


@dataclass(eq=False)
class Block:
    """The rows of one barrier in the present step."""

    barrier: Barrier
    near: Near
    rows: slice


class Rows:
    """Gathers the rows of a step; their number may change from step to step.

    A barrier's row is slope·v ≥ −rate(h) − drift with rate(h) = gain h/dt and, with acceleration
    limits, no more than the speed −a dt + √(a²dt² + 2ah) from which the distance can still be
    stopped at 0. Where h < 0 it asks for a way back at no more than `push`. What the box alone
    makes impossible is not asked for: the check of the command where it leads says what comes of
    that.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation):
        self._problem, self._evaluation = problem, evaluation
        model = problem.model
        self.barriers: list[Barrier] = [
            limit.build(model, evaluation.obstacle_twist) for limit in problem.barriers
        ]
        self._speeds = [
            (
                SpeedRows(limit, evaluation.data, model.nv),
                evaluation.rows_of([problem.term[limit.task]]),
            )
            for limit in problem.speeds
        ]
        self.speed_count = sum(speed.count for speed, _ in self._speeds)
        """How many of the first rows are of speeds."""
        self.any = bool(self.barriers or self._speeds or problem.mink_limits)
        """Whether there can be any."""
        self.count = 0
        self.matrix = np.zeros((0, problem.dofs.size))
        """C (count, n)."""
        self.lower, self.upper = np.zeros((2, 0))
        """lo and hi (count,)."""
        self.blocks: list[Block] = []
        """The barriers that have rows now."""
        self.passed = False
        """Whether a distance is below its limit."""
        self._plain: Array | None = None  # H without the curvature of speeds, once it has any
        self._inverse_acceleration = 1.0 / problem.box.acceleration  # 0 where there is no limit
        self._stops = bool(self._inverse_acceleration.any())
        self._travel = np.zeros(model.nv)
        self._slides = Slides(model, evaluation.obstacle_twist)

    def update(self, qp: QP, rate: Array, dt: float) -> None:
        """Write the rows at the present kinematics for a step of dt with ẋ of all terms.

        Of the program, its box is read.
        """
        problem, dofs = self._problem, self._problem.dofs
        parts: list[tuple[Array, Array, Array]] = []
        self.blocks = []
        self.passed = False
        self.count = 0
        for speed, part in self._speeds:
            full, bound = np.empty((speed.count, problem.model.nv)), np.empty(speed.count)
            speed.write(problem.model, self._evaluation.v_previous, rate[part], full, bound)
            self._add(parts, full[:, dofs], np.full(bound.size, -np.inf), bound)
        # Without a limit 0 · ∞ would be no number.
        low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
        fastest = np.maximum(np.abs(low), np.abs(high))
        travel = fastest * dt
        if self._stops:
            travel += 0.5 * fastest * fastest * self._inverse_acceleration
        self._travel.fill(0.0)
        self._travel[dofs] = travel
        self._slides.begin(self._evaluation.data.qpos, self._travel)
        self._slides.stretch(self._travel, dt)
        for barrier in self.barriers:
            near = barrier.near(self._evaluation.data, self._travel, dt)
            if near.ids.size:
                self.blocks.append(Block(barrier, near, slice(self.count, 0)))
                slope = near.slope[:, dofs]
                lower = self._lower(barrier, near, slope, (low, high), dt)
                self._add(parts, slope, lower, np.full(lower.size, np.inf))
                self.blocks[-1].rows = slice(self.count - lower.size, self.count)
        for rows, upper in self._mink_rows(dt):
            self._add(parts, rows, np.full(upper.size, -np.inf), upper)
        if parts:
            self.matrix = np.concatenate([part[0] for part in parts])
            self.lower = np.concatenate([part[1] for part in parts])
            self.upper = np.concatenate([part[2] for part in parts])

    def _add(
        self, parts: list[tuple[Array, Array, Array]], rows: Array, lower: Array, upper: Array
    ) -> None:
        parts.append((rows, lower, upper))
        self.count += upper.size

    def cut(self, qp: QP, v: Array, y: Array | None) -> bool:
        """Change the rows of a program, and its H, where v (n,) moves frames too fast.

        Return whether anything has changed: the program is then to be solved again. H is changed
        only with the multipliers y of the rows, and is to be `straightened` afterwards.
        """
        if not self._speeds:
            return False
        dofs, changed, first = self._problem.dofs, False, 0
        tangent, of_speeds = self._tangent(v), slice(self.speed_count)
        full = np.zeros((self.speed_count, self._problem.model.nv))
        full[:, dofs] = self.matrix[of_speeds]
        for speed in self.speeds:
            its = slice(first, first + speed.count)
            multiplier = None if y is None else y[its]
            changed |= speed.cut(tangent, multiplier, full[its], self.upper[its])
            first += speed.count
        if not changed:
            return False
        self.matrix[of_speeds] = full[:, dofs]
        qp.C[of_speeds], qp.hi[of_speeds] = self.matrix[of_speeds], self.upper[of_speeds]
        if y is not None:
            if self._plain is None:
                self._plain = qp.H.copy()
            qp.H[:] = self._plain
            for bend in (each for speed in self.speeds for each in speed.bends()):
                qp.H += bend[np.ix_(dofs, dofs)]
        return True

    def straighten(self, qp: QP) -> None:
        """Take what `cut` has added to a program's H out again."""
        if self._plain is not None:
            qp.H[:], self._plain = self._plain, None

    def excess(self, v: Array) -> float:
        """Return by how much v (n,) moves a frame too fast, at most, m/s or rad/s; ≤ 0 if not."""
        tangent = self._tangent(v)
        return max((speed.excess(tangent) for speed in self.speeds), default=0.0)

    def slowed(self, brake: Array, v: Array) -> Array:
        """Return v (n,) or what of it, from the brake b (n,) on, moves no frame too fast.

        v itself where b is too fast as well.
        """
        start, end = self._tangent(brake), self._tangent(v)
        share = min((speed.share(start, end) for speed in self.speeds), default=1.0)
        return brake + share * (v - brake) if 0.0 < share < 1.0 else v

    def _tangent(self, v: Array) -> Array:
        tangent = np.zeros(self._problem.model.nv)
        tangent[self._problem.dofs] = v
        return tangent

    def _lower(
        self,
        barrier: Barrier,
        near: Near,
        slope: Array,
        box: tuple[Array, Array],
        dt: float,
    ) -> Array:
        """Return what slope·v must at least be (k,)."""
        distance = near.distance
        rate = barrier.gain / dt * distance
        if self._stops:
            rate = np.minimum(rate, self._stopping(distance, slope, dt))
        lower = np.minimum(-rate, barrier.push) - near.drift
        # No row that only holds an approach back asks for more than the brake can do.
        braked = slope @ np.clip(0.0, *box)
        np.minimum(lower, braked - ROUNDING * np.abs(braked), out=lower, where=lower <= 0.0)
        fastest = np.maximum(slope * box[0], slope * box[1]).sum(axis=1)
        fastest -= ROUNDING * np.abs(fastest)
        beyond = lower > fastest
        lower[beyond] = fastest[beyond]
        self.passed |= bool(distance.min() < -self._problem.resolution)
        return lower

    def _stopping(self, distance: Array, slope: Array, dt: float) -> Array:
        """Return the speeds (k,) from which each distance can still be stopped at 0.

        With joint rates in proportion to the slope c, all joints at their a_max take
        s² Σ |c|³/a / (2 (c·c)²) from a speed s, so that a = (c·c)² / Σ |c|³/a.
        """
        steep = np.abs(slope)
        square = (steep * steep).sum(axis=1)
        weight = (steep**3) @ self._inverse_acceleration
        a = STOPPING * np.divide(
            square * square, weight, out=np.full(square.size, math.inf), where=weight > 0.0
        )
        finite = np.where(np.isfinite(a), a, 0.0)
        room = 2.0 * finite * np.maximum(distance, 0.0)
        root = np.sqrt((finite * dt) ** 2 + room) + finite * dt
        speed = np.divide(room, root, out=np.zeros_like(root), where=root > 0.0)
        return np.where(np.isfinite(a) & (distance >= 0.0), speed, np.inf)

    def _mink_rows(self, dt: float) -> list[tuple[Array, Array]]:
        """Return the rows C v ≤ hi of mink's limits, which say G Δq ≤ h."""
        found: list[tuple[Array, Array]] = []
        for limit in self._problem.mink_limits:
            self._evaluation.attempt(type(limit).__name__, self._add_mink_rows, found, limit, dt)
        return found

    def _add_mink_rows(
        self, found: list[tuple[Array, Array]], limit: mink.Limit, dt: float
    ) -> None:
        constraint = limit.compute_qp_inequalities(self._evaluation.configuration, dt)
        matrix, bound = parts("constraint", constraint, ("G", "h"))
        if matrix is None or bound is None:
            return
        rows = checked("G", matrix, (None, self._problem.model.nv))
        upper = checked("h", bound, (len(rows),), unlimited=True)
        found.append((rows[:, self._problem.dofs], upper / dt))

    def kept(self) -> "KeptRows":
        """Return what the present rows are of, for later."""
        blocks = [(block.barrier, block.near.ids, block.rows) for block in self.blocks]
        return KeptRows(self.speeds, blocks, self.lower, self.upper)

    @property
    def speeds(self) -> list[SpeedRows]:
        """The speeds whose rows come first."""
        return [speed for speed, _ in self._speeds]


@dataclass(frozen=True, eq=False)
class KeptRows:
    """What the rows of a step are of, and where they stand."""

    speeds: list[SpeedRows]
    blocks: list[tuple[Barrier, NDArray[np.intp], slice]]
    """The barriers that have rows, with the ids of their entries and the rows' place."""
    lower: Array
    upper: Array

    def packed(self, rows: Rows) -> "PackedRows":
        """Return the same with the places of the barriers in all rows instead of them."""
        blocks = [(rows.barriers.index(b), ids, place) for b, ids, place in self.blocks]
        return PackedRows(blocks, self.lower, self.upper)

    def described(self, row: int) -> tuple[str, str, float, float]:
        """Return the kind of limit that a row belongs to, what it is of, its lo and its hi.

        Of the planes that stand for a speed they are those of the speed.
        """
        first = 0
        for speed in self.speeds:
            if row < first + speed.count:
                half, largest = speed.half_of(row - first)
                return "speed", f"{speed.limit.task} ({half})", 0.0, largest
            first += speed.count
        bounds = float(self.lower[row]), float(self.upper[row])
        for barrier, ids, rows in self.blocks:
            if rows.start <= row < rows.stop:
                return barrier.kind, barrier.name(int(ids[row - rows.start])), *bounds
        return "mink", f"row {row - first}", *bounds


@dataclass(frozen=True, eq=False)
class PackedRows:
    """Kept rows apart from an engine, to be pickled."""

    blocks: list[tuple[int, NDArray[np.intp], slice]]
    lower: Array
    upper: Array

    def unpacked(self, rows: Rows) -> KeptRows:
        """Return them as those of an engine of the same problem."""
        blocks = [(rows.barriers[k], ids, place) for k, ids, place in self.blocks]
        return KeptRows(rows.speeds, blocks, self.lower, self.upper)
