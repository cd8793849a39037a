"""The second-order correction of rows that the curvature of a step would break."""

from collections.abc import Iterable
from dataclasses import dataclass

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


@dataclass(eq=False)
class Shortfall:
    """What the rows of a command fall short of where it leads."""

    raised: list[Array]
    """By how much lo of each block's rows has to rise, rad/s or m/s."""
    jumped: bool = False
    """Whether barriers have other functions, in `kept`, that hold there."""

    def __bool__(self) -> bool:
        return self.jumped or any(more.any() for more in self.raised)


def shortfall_of(
    blocks: list[Block],
    ends: Iterable[tuple[mujoco.MjData, float]],
    resolution: float,
    *,
    foresee: bool,
) -> Shortfall:
    """Return what the rows of a command that leads to `ends` fall short of.

    A row holds to first order in the way, slope·v t ≥ lo t for an end that is as far away as v goes
    in a time t; where the distance there is short of min(0, h now) by δ, lo has to rise by δ/t (the
    second-order correction of sequential quadratic programming: Fletcher 1982). A robot in touch
    can then slide, and not only stop. Where the distance there is one of other points, as of
    another corner, their row is what is missing, if it may `foresee`.
    """
    spare, found = (
        SPARE * resolution,
        Shortfall([np.zeros(block.near.ids.size) for block in blocks]),
    )
    for end, time in ends:
        for block, more in zip(blocks, found.raised, strict=True):
            near = block.near
            after = block.barrier.distances(end, near.ids)
            shortfall = np.minimum(near.distance, 0.0) + spare - after
            missing = (shortfall > spare).nonzero()[0]
            if foresee:
                jumped = block.barrier.foresee(end, near.ids[missing])
                found.jumped |= bool(jumped.any())
                missing = missing[~jumped]
            more[missing] = np.maximum(more[missing], ENOUGH / time * shortfall[missing])
    return found


def raise_rows(qp: QP, blocks: list[Block], raised: list[Array]) -> None:
    """Raise lo of the rows, in place, to no more than the box allows."""
    for block, more in zip(blocks, raised, strict=True):
        if more.any():
            # The box alone must still allow it; 0 · ∞ would be no number.
            rows = qp.C[block.rows]
            low, high = np.maximum(qp.lb, -FASTEST), np.minimum(qp.ub, FASTEST)
            most = np.maximum(rows * low, rows * high).sum(axis=1)
            most -= INSIDE * np.abs(most)
            qp.lo[block.rows] = np.minimum(qp.lo[block.rows] + more, most)
