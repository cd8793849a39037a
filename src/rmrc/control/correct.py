"""The second-order correction of rows that the curvature of a step would break."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.problem.problem import Problem
from rmrc.qp.program import QP
from rmrc.qp.rows import FASTEST, Block

Array = NDArray[np.float64]

ENOUGH = 1.1
"""What a shortfall is multiplied by: the corrected step has a curvature of its own."""
SPARE = 1e-7
"""Distance in m or rad that a corrected step aims at beyond its limit."""


class Correction:
    """Asks rows for what a step fell short of at its end, so that it can be solved again.

    A row holds to first order in the step, slope·v dt ≥ lo dt; where the distance after the step is
    short of min(0, h now) by δ, lo rises by δ/dt (the second-order correction of sequential
    quadratic programming: Fletcher 1982). A robot in touch can then slide, and not only stop.
    """

    def __init__(self, problem: Problem):
        self._model, self._dofs = problem.model, problem.dofs
        self._data = mujoco.MjData(problem.model)
        self._way = np.zeros(problem.model.nv)

    def raise_rows(
        self, qp: QP, blocks: list[Block], present: tuple[mujoco.MjData, Array], v: Array, dt: float
    ) -> bool:
        """Raise lo, in place, for a command v (n,); return whether anything fell short.

        `present` is the configuration with the mocap bodies, and their velocities (nmocap, 6).
        """
        now, twist = present
        data = self._data
        data.qpos[:] = now.qpos
        data.mocap_pos[:], data.mocap_quat[:] = now.mocap_pos + twist[:, :3] * dt, now.mocap_quat
        self._way[self._dofs] = v * dt
        mujoco.mj_integratePos(self._model, data.qpos, self._way, 1.0)
        mujoco.mj_kinematics(self._model, data)
        short = False
        for block in blocks:
            near = block.near
            after = block.barrier.distances(data, near.ids)
            shortfall = np.minimum(near.distance, 0.0) + SPARE - after
            missing = shortfall > SPARE
            if missing.any():
                short = True
                lower = qp.lo[block.rows]
                lower[missing] += ENOUGH / dt * shortfall[missing]
                # The box alone must still allow it; 0 · ∞ would be no number.
                rows = qp.C[block.rows]
                low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
                most = np.maximum(rows * low, rows * high).sum(axis=1)
                np.minimum(lower, most - SPARE * np.abs(most), out=lower)
        return short
