"""How far inside its limits a state is: what the record keeps of distances and speeds."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.limits.barrier import Barrier
from rmrc.limits.speed import FrameSpeed
from rmrc.problem.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Margin:
    """The least room that one kind of limit has at a state."""

    room: float
    """Below 0 the limit is passed."""
    unit: str
    name: str
    """What it is of."""


class Measure:
    """Measures a problem's barriers and frame speeds at states, apart from any controller."""

    def __init__(self, problem: Problem):
        model = self._model = problem.model
        self._data = mujoco.MjData(model)
        still = np.zeros((model.nmocap, 6))
        self._barriers = [limit.build(model, still) for limit in problem.barriers]
        self._speeds = problem.speeds
        self._jacobian = np.zeros((6, model.nv))
        kinds = [barrier.kind for barrier in self._barriers] + ["speed"] * bool(self._speeds)
        self.kinds = tuple(dict.fromkeys(kinds))
        """The kinds of limits that are measured."""

    def at(self, q: Array, v: Array, obstacles: mujoco.MjData) -> dict[str, Margin]:
        """Return the least room of each kind of limit at q (nq,) and v (nv,).

        Args:
            q: Configuration (nq,).
            v: Velocity (nv,).
            obstacles: The data that hold where the mocap bodies are.
        """
        data = self._data
        data.qpos[:] = q
        data.mocap_pos[:], data.mocap_quat[:] = obstacles.mocap_pos, obstacles.mocap_quat
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        found: dict[str, Margin] = {}
        for barrier in self._barriers:
            self._take(found, barrier.kind, self._nearest(barrier))
        for limit in self._speeds:
            self._take(found, "speed", self._slowness(limit, v))
        return found

    @staticmethod
    def _take(found: dict[str, Margin], kind: str, margin: Margin) -> None:
        if kind not in found or margin.room < found[kind].room:
            found[kind] = margin

    def _nearest(self, barrier: Barrier) -> Margin:
        room, identity = barrier.least(self._data)
        return Margin(room, barrier.unit, barrier.name(identity))

    def _slowness(self, limit: FrameSpeed, v: Array) -> Margin:
        jacobian = self._jacobian
        limit.frame.jacobian(self._model, self._data, jacobian[:3], jacobian[3:], limit.frame.id)
        twist = jacobian @ v
        linear = limit.linear - math.sqrt(twist[:3].dot(twist[:3]))
        angular = limit.angular - math.sqrt(twist[3:].dot(twist[3:]))
        if linear < angular:
            return Margin(linear, "m/s", limit.task)
        return Margin(angular, "rad/s", limit.task)
