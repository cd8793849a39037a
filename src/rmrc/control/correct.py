"""The second-order correction of rows that the curvature of a step would break."""

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
    qp: QP, blocks: list[Block], end: mujoco.MjData, dt: float, resolution: float
) -> bool:
    """Raise lo, in place, for a step that leads to `end`; return whether anything fell short.

    A row holds to first order in the step, slope·v dt ≥ lo dt; where the distance after the step is
    short of min(0, h now) by δ, lo rises by δ/dt (the second-order correction of sequential
    quadratic programming: Fletcher 1982). A robot in touch can then slide, and not only stop.
    """
    short, spare = False, SPARE * resolution
    for block in blocks:
        near = block.near
        after = block.barrier.distances(end, near.ids)
        shortfall = np.minimum(near.distance, 0.0) + spare - after
        missing = shortfall > spare
        if missing.any():
            short = True
            lower = qp.lo[block.rows]
            lower[missing] += ENOUGH / dt * shortfall[missing]
            # The box alone must still allow it; 0 · ∞ would be no number.
            rows = qp.C[block.rows]
            low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
            most = np.maximum(rows * low, rows * high).sum(axis=1)
            np.minimum(lower, most - INSIDE * np.abs(most), out=lower)
    return short
