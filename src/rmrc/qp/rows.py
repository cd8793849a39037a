"""The rows lo ≤ C v ≤ hi of a step: barriers, speeds of frames, and limits of mink's."""

from dataclasses import dataclass

import mink
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.barrier import Barrier, Near
from rmrc.limits.box import braked
from rmrc.limits.slides import Slides
from rmrc.limits.speed import SpeedRows
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.foreign import checked, parts
from rmrc.qp.program import QP

Array = NDArray[np.float64]

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

    A barrier's row is c·v ≥ −rate − drift with the slope c and rate = gain h/dt. With acceleration
    limits the robot brakes along the line that it moves on, in N = max |u_i|/(a_i dt) steps from
    the velocity u before (see `braking`), on which a distance that falls at s falls by s (N + 1)/2
    dt until rest. N changes by at most 1 in a step, and in proportion to s where the robot brakes,
    with the deceleration α = −c·u/(N dt) of the distance. So

        rate = max(2 gain h/((M + 2) dt), −α dt + √(α²dt² + 2 α gain h)),  M = max v_max,i/(a_i dt):

    the second brakes the approach, and comes to 2 gain h/(N dt) where other motions, as along a
    wall, keep N up; the first is what can be stopped whatever moves. From rest M is 0, but for what
    comes near by itself, from which a retreat has to begin in time. No column of a row depends on
    u, nor does the first: joints that do nearly the same would take turns.

    Where h < 0 the row asks for a way back at no more than `push`. What the box alone makes
    impossible is not asked for: the check of the command where it leads says what comes of that.
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
        self.kept_blocks: list[Block] = []
        """The rows of what bounds their distances from above."""
        self.passed = False
        """Whether a distance is below its limit."""
        self._plain: Array | None = None  # H without the curvature of speeds, once it has any
        self._travel, self._before = np.zeros(model.nv), np.zeros(problem.dofs.size)
        self._slides = Slides(model, evaluation.obstacle_twist)

    def update(self, qp: QP, rate: Array, dt: float) -> None:
        """Write the rows at the present kinematics for a step of dt with ẋ of all terms.

        Of the program, its box is read.
        """
        problem, dofs = self._problem, self._problem.dofs
        parts: list[tuple[Array, Array, Array]] = []
        self.blocks, self.kept_blocks = [], []
        self.passed = False
        self.count = 0
        for speed, part in self._speeds:
            full, bound = np.empty((speed.count, problem.model.nv)), np.empty(speed.count)
            speed.write(problem.model, self._evaluation.v_previous, rate[part], full, bound)
            self._add(parts, full[:, dofs], np.full(bound.size, -np.inf), bound)
        # Without a limit 0 · ∞ would be no number.
        low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
        fastest = np.maximum(np.abs(low), np.abs(high))
        travel, acceleration = fastest * dt, problem.box.acceleration
        slows, longest = np.isfinite(acceleration), (fastest / (acceleration * dt)).max()
        travel[slows] *= 1.0 + 0.5 * longest
        self._before = self._evaluation.v_previous[dofs]
        brake = braked(problem.box, self._before, dt, self._evaluation.data.qpos)
        brake = np.clip(brake, low, high)
        self._travel.fill(0.0)
        self._travel[dofs] = travel
        self._slides.begin(self._evaluation.data.qpos, self._travel)
        self._slides.stretch(self._travel, dt)
        for barrier in self.barriers:
            near = barrier.near(self._evaluation.data, self._travel, dt)
            if near.ids.size:
                self.blocks.append(Block(barrier, near, slice(self.count, 0)))
                self._add_near(parts, barrier, near, (low, high, brake), dt)
                self.blocks[-1].rows = slice(self.count - near.ids.size, self.count)
                kept = barrier.kept(self._evaluation.data)
                if kept is not None and kept.ids.size:
                    self._add_near(parts, barrier, kept, (low, high, brake), dt)
                    rows = slice(self.count - kept.ids.size, self.count)
                    self.kept_blocks.append(Block(barrier, kept, rows))
        for rows, upper in self._mink_rows(dt):
            self._add(parts, rows, np.full(upper.size, -np.inf), upper)
        if parts:
            self.matrix = np.concatenate([part[0] for part in parts])
            self.lower = np.concatenate([part[1] for part in parts])
            self.upper = np.concatenate([part[2] for part in parts])

    def _add_near(
        self,
        parts: list[tuple[Array, Array, Array]],
        barrier: Barrier,
        near: Near,
        box: tuple[Array, Array, Array],
        dt: float,
    ) -> None:
        """Add the rows of what is near, inside a box with its brake."""
        slope = near.slope[:, self._problem.dofs]
        lower = self._lower(barrier, near, slope, dt)
        self._bound(slope, lower, *box)
        self._add(parts, slope, lower, np.full(lower.size, np.inf))

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

    def _lower(self, barrier: Barrier, near: Near, slope: Array, dt: float) -> Array:
        """Return what c·v must at least be (k,) for the slopes c (k, n)."""
        distance = near.distance
        self.passed |= bool(distance.min() < -self._problem.resolution)
        room = barrier.gain * distance
        limits, before = self._problem.box, np.abs(self._before)
        longest = float((before / (limits.acceleration * dt)).max())
        fastest = np.maximum(before, np.where(limits.velocity < FASTEST, limits.velocity, 0.0))
        most = float((fastest / (limits.acceleration * dt)).max())
        steps = np.where((longest > 0.0) | (near.drift < 0.0), most, 0.0)
        rate = room * 2.0 / ((steps + 2.0) * dt)
        if longest > 0.0:
            approach = -(slope * self._before).sum(axis=1)  # by @ its last bit depends on addresses
            slower = np.maximum(approach, 0.0) / longest  # α dt
            reach = 2.0 * np.maximum(room, 0.0) * (slower / dt)
            root = np.sqrt(slower * slower + reach) + slower
            own = np.divide(reach, root, out=np.zeros_like(root), where=root > 0.0)
            rate = np.maximum(rate, own)
        rate = np.where(distance >= 0.0, rate, room / dt)
        return np.minimum(-rate, barrier.push) - near.drift

    @staticmethod
    def _bound(slope: Array, lower: Array, low: Array, high: Array, brake: Array) -> None:
        """Lower what slope·v must be (k,), in place, to what the box allows.

        No row that only holds an approach back asks for more than the brake can do.
        """
        least = (slope * brake).sum(axis=1)
        np.minimum(lower, least - ROUNDING * np.abs(least), out=lower, where=lower <= 0.0)
        fastest = np.maximum(slope * low, slope * high).sum(axis=1)
        fastest -= ROUNDING * np.abs(fastest)
        np.minimum(lower, fastest, out=lower)

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
        blocks = [
            (block.barrier, block.near.ids, block.rows) for block in self.blocks + self.kept_blocks
        ]
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
