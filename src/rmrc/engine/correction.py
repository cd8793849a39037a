"""The second-order correction of rows that the curvature of a step would break."""

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.qp.program import QP
from rmrc.qp.rows import FASTEST, Block

Array = NDArray[np.float64]

ENOUGH = 1.1
"""What a shortfall is multiplied by: the corrected step has a curvature of its own."""
SPARE = 0.1
"""Distance that a corrected step aims at beyond its limit, in resolutions."""
INSIDE = 1e-7
"""Share by which a raised row stays below the fastest that the box allows."""


def raise_rows(
    qp: QP, blocks: list[Block], ends: Iterable[tuple[mujoco.MjData, float]], resolution: float
) -> bool:
    """Raise lo, in place, for a command that leads to `ends`; return whether anything fell short.

    A row holds to first order in the way, slope·v t ≥ lo t for an end that is as far away as v goes
    in a time t; where the distance there is short of min(0, h now) by δ, lo rises by δ/t (the
    second-order correction of sequential quadratic programming: Fletcher 1982). A robot in touch
    can then slide, and not only stop.
    """
    spare = SPARE * resolution
    raised = [np.zeros(block.near.ids.size) for block in blocks]
    for end, time in ends:
        for block, more in zip(blocks, raised, strict=True):
            near = block.near
            after = block.barrier.distances(end, near.ids)
            shortfall = np.minimum(near.distance, 0.0) + spare - after
            missing = shortfall > spare
            np.maximum(more, ENOUGH / time * shortfall, out=more, where=missing)
    for block, more in zip(blocks, raised, strict=True):
        if more.any():
            # The box alone must still allow it; 0 · ∞ would be no number.
            rows = qp.C[block.rows]
            low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
            most = np.maximum(rows * low, rows * high).sum(axis=1)
            most -= INSIDE * np.abs(most)
            qp.lo[block.rows] = np.minimum(qp.lo[block.rows] + more, most)
    return any(more.any() for more in raised)
