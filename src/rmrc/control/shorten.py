"""The check of a command where it leads, and its shortening where a distance would be passed."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.problem import Problem
from rmrc.qp.rows import PASSED, Block

Array = NDArray[np.float64]

TOLERANCE = 0.5 * PASSED
"""How far below 0 a distance may be at the end of a step, m or rad."""
TRIALS = 10
"""Most shares of a command that are tried, once the whole of it is too much."""
LOOKS = 24
"""Most configurations on the way to rest that are looked at, unless a thin geom asks for more."""
NARROW = 1e-3
"""Room in m or rad below which a minimum on the way to rest is looked at more closely."""
NEARER = 0.98
"""Share of the way to where a straight line puts the limit, for distances are curved."""
LEAST_PART, CLOSE = 0.1, 0.01
"""Least share of the interval that a trial takes off, and length at which it is short enough."""

Watched = tuple[Block, NDArray[np.intp]]
"""A barrier, and which of its near entries the motion could carry below their limit."""


class Shortening:
    """Keeps distances at the configuration that a command leads to, for rows are first order.

    The command goes from the brake b, the point of the box nearest to rest, to v: b + s (v − b) is
    inside the box for 0 ≤ s ≤ 1. s is the largest found at which no distance h falls below
    min(0, h now), neither after the step nor, with acceleration limits, at any step after it in
    which the joints brake at a_max. So b keeps what the step before has left: the robot can always
    stop. On the way to rest a look may be skipped where no motion could use up the distance that
    there is (conservative advancement: Mirtich 1996).
    """

    def __init__(self, problem: Problem):
        self._model, self._dofs = problem.model, problem.dofs
        self._data = mujoco.MjData(problem.model)
        limited = np.isfinite(problem.box.acceleration)
        self._deceleration = np.where(limited, problem.box.acceleration, math.inf)
        self._brakes = bool(limited.any())
        self._tangent = np.zeros(problem.model.nv)
        self._q = np.zeros(problem.model.nq)
        self._start, self._seconds = np.zeros(problem.model.nq), 0.0

    def share(
        self,
        data: mujoco.MjData,
        twist: Array,
        v: Array,
        brake: Array,
        blocks: list[Block],
        dt: float,
    ) -> tuple[float, bool]:
        """Return s, and whether a distance falls below its limit even so.

        Args:
            data: The present configuration and the mocap bodies.
            twist: Velocities of the mocap bodies (nmocap, 6).
            v: The command (n,).
            brake: b (n,).
            blocks: The barriers that are near.
            dt: Length of the step, s.
        """
        watched = self._watched(v, brake, blocks, dt)
        if not watched:
            return 1.0, False
        self._start[:], self._seconds = data.qpos, dt
        self._move_obstacles(data, twist, dt)
        low, high = 0.0, 1.0
        room_high = self._room(v, watched, dt)
        if room_high >= 0.0:
            return 1.0, False
        room_low = self._room(brake, watched, dt)
        if room_low < 0.0:
            return 0.0, True
        for _ in range(TRIALS):
            part = NEARER * room_low / (room_low - room_high)
            share = low + (high - low) * min(max(part, LEAST_PART), 1.0 - LEAST_PART)
            room = self._room(brake + share * (v - brake), watched, dt)
            if room < 0.0:
                high, room_high = share, room
            else:
                low, room_low = share, room
                if room <= TOLERANCE or high - low < CLOSE:
                    break
        return low, False

    def _watched(self, v: Array, brake: Array, blocks: list[Block], dt: float) -> list[Watched]:
        """Return the entries that the motion could carry below their limit."""
        longest = np.maximum(np.abs(self._way(v, dt)), np.abs(self._way(brake, dt)))
        self._tangent[:] = 0.0
        self._tangent[self._dofs] = longest
        watched = []
        for block in blocks:
            fall = block.barrier.reach(block.near.ids, self._tangent, dt)
            chosen = np.flatnonzero(block.near.distance < fall)
            if chosen.size:
                watched.append((block, chosen))
        return watched

    def _way(self, v: Array, dt: float, steps: int | None = None) -> Array:
        """Return how far a step of v and the braking after it lead (n,): all of it, or a part.

        In step i of the braking a joint still has |v| − i a dt.
        """
        if not self._brakes:
            return v * dt
        change = self._deceleration * dt
        count = np.floor(np.abs(v) / change)
        if steps is not None:
            count = np.minimum(count, steps)
        braked = 0.5 * np.where(count > 0.0, change, 0.0) * (count * (count + 1.0))  # no ∞ · 0
        return np.sign(v) * ((count + 1.0) * np.abs(v) - braked) * dt

    def _room(self, command: Array, watched: list[Watched], dt: float) -> float:
        """Return the least distance above what is allowed, on the way of a command to rest.

        It is that of the first look at which it is below 0, where there is one.
        """
        parts, first = self._parts(command, watched, dt), command * dt
        least, rooms = math.inf, []
        for k in range(1, parts + 1):
            rooms = self._rooms(first * (k / parts), watched)
            least = min(least, *(float(room.min()) for room in rooms))
            if least < 0.0:
                return least
        if not self._brakes:
            return least
        last = int(np.max(np.floor(np.abs(command) / (self._deceleration * dt))))
        step, longest, at = 0, max(1, math.ceil(last / LOOKS)), first
        looks = [(0, least)]
        while step < last:
            step = self._next(command, at, rooms, watched, (step, last, longest), dt)
            at = self._way(command, dt, step)
            rooms = self._rooms(at, watched)
            looks.append((step, min(float(room.min()) for room in rooms)))
            if looks[-1][1] < 0.0:
                return looks[-1][1]
        return min(least, self._refined(command, looks, watched, dt))

    def _refined(
        self, command: Array, looks: list[tuple[int, float]], watched: list[Watched], dt: float
    ) -> float:
        """Return the least room of the braking, with every step looked at around its minimum."""
        k = min(range(len(looks)), key=lambda k: looks[k][1])
        least = looks[k][1]
        if least > NARROW:
            return least
        before, after = looks[max(k - 1, 0)][0], looks[min(k + 1, len(looks) - 1)][0]
        for step in range(before + 1, after):
            if step != looks[k][0]:
                rooms = self._rooms(self._way(command, dt, step), watched)
                least = min(least, *(float(room.min()) for room in rooms))
        return least

    def _parts(self, command: Array, watched: list[Watched], dt: float) -> int:
        """Return into how many parts to cut the step, so that nothing is passed through."""
        self._tangent[:] = 0.0
        self._tangent[self._dofs] = np.abs(command) * dt
        passes = 1.0
        for block, chosen in watched:
            ids = block.near.ids[chosen]
            fall = block.barrier.reach(ids, self._tangent, dt)
            passes = max(passes, float(np.max(fall / block.barrier.thickness(ids))))
        return min(math.ceil(passes), LOOKS)

    def _next(
        self,
        command: Array,
        at: Array,
        rooms: list[Array],
        watched: list[Watched],
        braking: tuple[int, int, int],
        dt: float,
    ) -> int:
        """Return the next step of the braking to look at: none before it can use up the room.

        `braking` is the present step, the last, and the most steps that go without a look.
        """
        step, last, longest = braking
        following = last
        while following - step > longest:
            self._tangent[:] = 0.0
            self._tangent[self._dofs] = np.abs(self._way(command, dt, following) - at)
            if all(
                (block.barrier.reach(block.near.ids[chosen], self._tangent, 0.0) <= room).all()
                for (block, chosen), room in zip(watched, rooms, strict=True)
            ):
                break
            following = step + max(longest, (following - step) // 2)
        return following

    def _rooms(self, way: Array, watched: list[Watched]) -> list[Array]:
        """Return the distances above what is allowed after a way (n,) of the joints.

        Those that the way cannot use up are not measured: they are at least what it leaves.
        """
        self._tangent[:] = 0.0
        self._tangent[self._dofs] = way
        self._q[:] = self._start
        mujoco.mj_integratePos(self._model, self._q, self._tangent, 1.0)
        self._data.qpos[:] = self._q
        mujoco.mj_kinematics(self._model, self._data)
        np.abs(self._tangent, out=self._tangent)
        rooms = []
        for block, chosen in watched:
            ids, distance = block.near.ids[chosen], block.near.distance[chosen]
            room = distance - block.barrier.reach(ids, self._tangent, self._seconds)
            reached = room < 0.0
            if reached.any():
                floor = np.minimum(distance[reached], -TOLERANCE)
                room[reached] = block.barrier.distances(self._data, ids[reached]) - floor
            rooms.append(room)
        return rooms

    def _move_obstacles(self, data: mujoco.MjData, twist: Array, dt: float) -> None:
        """Put the mocap bodies where they will be at the end of the step."""
        if not twist.size:
            return
        own = self._data
        own.mocap_pos[:], own.mocap_quat[:] = data.mocap_pos + twist[:, :3] * dt, data.mocap_quat
        for quaternion, rate in zip(own.mocap_quat, twist[:, 3:], strict=True):
            # mju_quatIntegrate turns by a rate in the body's own axes, and this is the world's.
            local = np.empty(3)
            inverse = np.empty(4)
            mujoco.mju_negQuat(inverse, quaternion)
            mujoco.mju_rotVecQuat(local, rate, inverse)
            mujoco.mju_quatIntegrate(quaternion, local, dt)
