"""The check of a command where it leads, and its shortening where a distance would be passed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.box import Box, braking
from rmrc.limits.collision import Collision
from rmrc.limits.slides import Slides
from rmrc.model.carrier import carry_on
from rmrc.model.configuration import turning_dofs
from rmrc.problem.problem import Problem
from rmrc.qp.rows import Block

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

TOLERANCE = 0.5
"""How far below 0 a distance may be at the end of a step, in resolutions."""
NOISE = 1e-3
"""How much a distance below 0 may lose by rounding, in resolutions."""
MOST_LOOKS = 256
"""Looks at a way to rest after which what is not known to be free counts as passed."""
TRIALS = 10
"""Most shares of a command that are tried, once the whole of it is too much."""
GUESSES = 10
"""Most shares at which one distance is measured, before all of them are looked at."""
MOST_STEPS = 2.0**53
"""Most steps to rest that are counted: there are no larger whole numbers that all are floats."""
MOST_PARTS = 24
"""Most parts of a step that are looked at, so that nothing is passed through."""
NEARER = 0.98
"""Share of the way to where a straight line puts the limit, for distances are curved."""
LEAST_PART, CLOSE = 0.1, 0.01
"""Least share of the interval that a guess takes off, and length at which it is short enough."""


class _Path:
    """The way of a step with v, and of those after it, in which the joints brake (see `braking`).

    Its places are counted in steps: 0 is the present configuration, 1 where v leads, and at `last`
    all joints rest.
    """

    def __init__(self, v: Array, box: Box, dt: float, q: Array | None = None):
        self._sign, self._speed, self.dt = np.sign(v), np.abs(v), dt
        steps, change = braking(box, v, dt, q, ahead=dt)
        self._count = np.floor(steps)
        self._change = np.where(change < math.inf, change, 0.0)  # no ∞ · 0
        self._half = 0.5 * self._change
        self.last = 1 + int(min(self._count.max(), MOST_STEPS))

    def way(self, place: float) -> Array:
        """Return how far the joints have moved at a place (n,)."""
        if place <= 1.0:
            return self._sign * self._speed * (place * self.dt)
        count = np.minimum(self._count, place - 1.0)
        return self._sign * (
            ((count + 1.0) * self._speed - self._half * (count * (count + 1.0))) * self.dt
        )

    def motion(self, place: float) -> tuple[Array, Array]:
        """Return the largest |q̇| and |q̈| of the joints after a place (n,)."""
        moving = self._count >= place
        return (self._speed - place * self._change) * moving, self._change * (moving / self.dt)


class _Watched:
    """The entries of a barrier that a motion could carry below what is allowed."""

    def __init__(self, block: Block, chosen: Ids, resolution: float):
        self.barrier, self.ids = block.barrier, block.near.ids[chosen]
        distance = block.near.distance[chosen]
        self.floor = np.minimum(distance - NOISE * resolution, -TOLERANCE * resolution)
        self.now = block.near.distance[chosen] - self.floor
        """What is known of the rooms at the present configuration (k,)."""

    def known(self, data: mujoco.MjData, which: Ids) -> Array:
        """Return what is known of the rooms of some entries (k,) without measuring."""
        return self.measured(data, which)

    def measured(self, data: mujoco.MjData, which: Ids) -> Array:
        """Return the rooms of some entries (k,)."""
        return self.barrier.distances(data, self.ids[which]) - self.floor[which]

    def falls(self, which: Ids, motion: "_Motion") -> tuple[Array, Array]:
        """Return by how much some rooms (k,) can fall in a motion, and what is known accelerate."""
        ids, reach = self.ids[which], self.barrier.reach
        return reach(ids, motion.step, 0.0), reach(ids, motion.bend, 0.0)


@dataclass(eq=False)
class _Motion:
    """A bound of a motion over all dofs (nv,), stretched by the slides."""

    step: Array
    """|Δq|."""
    speed: Array
    """|q̇|."""
    change: Array
    """|q̈|."""
    bend: Array
    """What times the levers bounds the acceleration of any point: |q̈| + ω |q̇|, with the sum ω of
    all rates of turning, and ω twice for what slides."""


class _WatchedPairs(_Watched):
    """Pairs of geoms, with planes between them that say what need not be measured."""

    def __init__(
        self,
        block: Block,
        chosen: Ids,
        resolution: float,
        collision: Collision,
        data: mujoco.MjData,
        reach: Array,
    ):
        super().__init__(block, chosen, resolution)
        self._planes = collision.planes(data, self.ids)
        self.now = self._planes.distance - self.floor
        self._levers, self._carried, self._moves = collision.motion(self.ids, reach)

    def known(self, data: mujoco.MjData, which: Ids) -> Array:
        return self._planes.least(data, which) - self.floor[which]

    def falls(self, which: Ids, motion: _Motion) -> tuple[Array, Array]:
        carried, moves = self._carried[which], self._moves[which]
        bend = carried @ motion.change + (carried @ motion.speed) * (moves @ motion.speed)
        return self._levers[which] @ motion.step, bend


@dataclass(eq=False)
class _Look:
    """What a look at one place gave: rooms, distances above what is allowed."""

    place: float
    way: Array
    room: list[Array]
    """Of each barrier that is watched (k,); ∞ where it was not looked at."""
    known: list[Array]
    """What is known of them without measuring (k,), and how fast it changes."""
    least: float = math.inf
    worst: tuple[_Watched, int] | None = None
    """The barrier and the entry that have it."""


class Shortening:
    """Keeps distances at the configuration that a command leads to, for rows are first order.

    The command goes from the brake b, the point of the box nearest to rest, to v: b + s (v − b) is
    inside the box for 0 ≤ s ≤ 1. s is the largest found at which no distance h falls below
    min(0, h now), neither after the step nor, with acceleration limits, at any step after it in
    which the joints brake at a_max. So b keeps what the step before has left: the robot can always
    stop. The way to rest is halved until each part is known to be free: by planes between the geoms
    and the most that a path can bend between two looks, or by the distances at both and the most
    that the joints can take off them (as conservative advancement does: Mirtich 1996).
    """

    def __init__(self, problem: Problem, twist: Array):
        """`twist` (nmocap, 6) are the velocities of the mocap bodies; whoever moves them writes."""
        self._model, self._dofs = problem.model, problem.dofs
        self._data = mujoco.MjData(problem.model)
        self._box = problem.box
        self._slows = bool(np.isfinite(problem.box.acceleration).all())
        self._slides, self._twist = Slides(problem.model, twist), twist
        self._turning = turning_dofs(problem.model)
        self._resolution, self._tolerance = problem.resolution, TOLERANCE * problem.resolution
        self._start, self._steady, self._still = np.zeros(problem.model.nq), True, True
        self.deadline = math.inf
        """When looking has to end, on the clock of `perf_counter`, s."""

    def share(
        self, data: mujoco.MjData, v: Array, brake: Array, blocks: list[Block], dt: float
    ) -> tuple[float, bool]:
        """Return s, and whether a distance falls below its limit even so.

        What the clock cuts short is not known to keep distances: s is then 0, for the brake is what
        the step before has left, and only the end of the step is looked at.

        Args:
            data: The present configuration and the mocap bodies.
            v: The command (n,).
            brake: b (n,).
            blocks: The barriers that are near.
            dt: Length of the step, s.
        """
        self._start[:] = data.qpos
        whole, rest = (_Path(command, self._box, dt, self._start) for command in (v, brake))
        watched = self._watched(data, whole, blocks)
        if not watched:
            return 1.0, False
        self._still = not self._twist.any()
        self._steady = self._still and self._slows
        carry_on(self._data, data, self._twist, dt)
        look = self._worst(whole, watched)
        if look.least >= 0.0:
            return 1.0, False
        # No joint is faster, or takes longer to rest, at any share between the two.
        fastest = _Path(np.maximum(np.abs(v), np.abs(brake)), self._box, dt)
        watched = self._watched(data, fastest, blocks)
        high = 1.0
        for trial in range(TRIALS):
            if self._is_over():
                break
            high = self._guess(look, (v, brake), high, dt) * (1.0 - LEAST_PART * trial)
            if high == 0.0:
                break
            command = brake + high * (v - brake)
            look = self._worst(_Path(command, self._box, dt, self._start), watched)
            if look.least >= 0.0:
                return high, False
        if not self._is_over():
            # What the step before has left may be used up by rounding.
            passed = self._worst(rest, watched, -self._tolerance).least < -self._tolerance
            if not passed or not self._is_over():
                return 0.0, passed
        if self._still and not brake.any():
            return 0.0, False
        # The brake may move on, as where joints come back into their ranges: one look at its end.
        everything = [np.arange(each.ids.size) for each in watched]
        return 0.0, self._look(rest, 1.0, watched, everything).least < -self._tolerance

    def _is_over(self) -> bool:
        """Return whether the time is over."""
        return self.deadline < math.inf and perf_counter() >= self.deadline

    def ends(
        self, data: mujoco.MjData, v: Array, dt: float
    ) -> Iterator[tuple[mujoco.MjData, float]]:
        """Yield where v (n,) leads to in a step of dt, and where it comes to rest.

        Each is there until the next is asked for; with it comes how long v takes to go there, s.
        """
        self._start[:] = data.qpos
        carry_on(self._data, data, self._twist, dt)
        path = _Path(v, self._box, dt, self._start)
        for place in (1, path.last)[: path.last]:
            way = path.way(place)
            self._place(way)
            fastest = int(np.abs(v).argmax())
            yield self._data, float(way[fastest] / v[fastest]) if v[fastest] else dt

    def _watched(self, data: mujoco.MjData, path: _Path, blocks: list[Block]) -> list[_Watched]:
        """Return the entries that a motion no longer than a path could carry below their limit."""
        step, dt, watched = self._over_all(np.abs(path.way(path.last))), path.dt, []
        self._slides.begin(data.qpos, step)
        self._slides.stretch(step, dt)
        for block in blocks:
            barrier = block.barrier
            reach = barrier.reach(block.near.ids, step, dt)
            chosen = (block.near.distance < reach).nonzero()[0]
            if chosen.size and isinstance(barrier, Collision):
                watched.append(
                    _WatchedPairs(block, chosen, self._resolution, barrier, data, reach[chosen])
                )
            elif chosen.size:
                watched.append(_Watched(block, chosen, self._resolution))
        return watched

    def _over_all(self, values: Array) -> Array:
        """Return values of the dofs that may move as those of all dofs (nv,)."""
        tangent = np.zeros(self._model.nv)
        tangent[self._dofs] = values
        return tangent

    def _guess(
        self,
        look: _Look,
        ends: tuple[Array, Array],
        high: float,
        dt: float,
    ) -> float:
        """Return a share below `high` at which the worst entry of a look has room again."""
        assert look.worst is not None
        (v, brake), each, entry = ends, look.worst[0], np.array([look.worst[1]])
        low, room_low, room_high, share = 0.0, math.inf, look.least, 0.0
        for _ in range(GUESSES):
            path = _Path(brake + share * (v - brake), self._box, dt, self._start)
            self._place(path.way(look.place))
            room = float(each.measured(self._data, entry)[0])
            if room < 0.0:
                high, room_high = share, room
            else:
                low, room_low = share, room
            if not high or high - low < CLOSE or (room_low <= self._tolerance and low):
                break
            part = NEARER * room_low / (room_low - room_high)
            share = low + (high - low) * min(max(part, LEAST_PART), 1.0 - LEAST_PART)
        return low

    def _worst(self, path: _Path, watched: list[_Watched], least: float = 0.0) -> _Look:
        """Return the first look on a path to rest at which a room is below `least`; else any.

        After the deadline none is known to be free.
        """
        every = [np.arange(each.ids.size) for each in watched]
        end = self._look(path, path.last, watched, every)
        if end.least < least:
            return end
        if self._steady or (self._still and path.last == 1):
            now = [each.now for each in watched]
            before = _Look(0, np.zeros_like(end.way), now, now)
            every = self._doubtful(path, before, end, watched, every)
            if not any(among.size for among in every):
                return end
        parts = self._parts(path, watched, every)
        for k in range(1, parts):
            look = self._look(path, k / parts, watched, every)
            if self._is_over():
                look.least = -math.inf
            if look.least < least:
                return look
        if path.last == 1:
            return end
        begin = self._look(path, 1, watched, every)
        if begin.least < least:
            return begin
        return self._halved(path, (begin, end), watched, every, least)

    def _halved(
        self,
        path: _Path,
        ends: tuple[_Look, _Look],
        watched: list[_Watched],
        among: list[Ids],
        least: float,
    ) -> _Look:
        """Return a look between two at which a room is, or may be, below `least`; else the last."""
        ahead, looks = [(*ends, among)], 0
        while ahead:
            before, after, among = ahead.pop()
            steps = int(after.place - before.place)
            if steps == 1:
                continue
            among = self._doubtful(path, before, after, watched, among)
            if any(some.size for some in among):
                between = self._look(path, before.place + steps // 2, watched, among)
                looks += 1
                unknown = looks > MOST_LOOKS or self._is_over()
                if unknown and between.least >= least:
                    between.least = -math.inf
                if between.least < least:
                    return between
                ahead += [(between, after, among), (before, between, among)]
        return ends[1]

    def _parts(self, path: _Path, watched: list[_Watched], among: list[Ids]) -> int:
        """Return into how many parts to cut the step, so that nothing is passed through."""
        step, passes = self._over_all(np.abs(path.way(1))), 1.0
        self._slides.stretch(step, path.dt)
        for each, some in zip(watched, among, strict=True):
            ids = each.ids[some]
            fall = each.barrier.reach(ids, step, path.dt) / each.barrier.thickness(ids)
            passes = max(passes, float(fall.max(initial=0.0)))
        return min(math.ceil(passes), MOST_PARTS)

    def _doubtful(
        self,
        path: _Path,
        before: _Look,
        after: _Look,
        watched: list[_Watched],
        among: list[Ids],
    ) -> list[Ids]:
        """Return which entries could fall below what is allowed between two looks.

        In a time T a motion with the acceleration a leaves its chord by no more than a T²/8.
        """
        step = self._over_all(np.abs(after.way - before.way))
        speed, change = (self._over_all(values) for values in path.motion(before.place))
        turn = np.where(self._turning, 1.0, 2.0) * speed[self._turning].sum()
        motion = _Motion(step, speed, change, change + turn * speed)
        for values in (motion.step, motion.speed, motion.change, motion.bend):
            self._slides.stretch(values, 0.0)
        time = (after.place - before.place) * path.dt
        found = []
        for n, (each, some) in enumerate(zip(watched, among, strict=True)):
            reach, bend = each.falls(some, motion)
            known = np.minimum(before.known[n][some], after.known[n][some])
            free = known >= bend * (time * time / 8.0)
            free |= before.room[n][some] + after.room[n][some] >= reach
            found.append(some[~free])
        return found

    def _look(self, path: _Path, place: float, watched: list[_Watched], among: list[Ids]) -> _Look:
        """Look at some entries of each barrier, and measure those not known to have room."""
        way = path.way(place)
        look = _Look(place, way, [], [])
        self._place(way)
        for each, some in zip(watched, among, strict=True):
            known = np.full(each.ids.size, math.inf)
            known[some] = each.known(self._data, some)
            room = known.copy()
            short = (~(known >= 0.0)).nonzero()[0]
            if short.size:
                room[short] = each.measured(self._data, short)
            least = int(room.argmin())
            if room[least] < look.least:
                look.least, look.worst = float(room[least]), (each, least)
            look.room.append(room)
            look.known.append(known)
        return look

    def _place(self, way: Array) -> None:
        """Run the kinematics after a way (n,) of the joints."""
        qpos = self._data.qpos
        qpos[:] = self._start
        mujoco.mj_integratePos(self._model, qpos, self._over_all(way), 1.0)
        mujoco.mj_kinematics(self._model, self._data)
