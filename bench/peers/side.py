"""What a side is: it takes steps, and tells where they have led."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Work = dict[str, Any]
"""What is to be done, as `cases.py` writes it down."""

TRIAL = 300
"""Steps by which backends are compared, a third of them to warm up."""


@dataclass(frozen=True)
class Side:
    """One library, set up for the work."""

    step: Callable[[int], object]
    """Set the targets of step k, solve, integrate."""
    configuration: Callable[[], np.ndarray]
    """The configuration q now, as MuJoCo orders it."""
    solver: str


def timed(step: Callable[[int], object], k: int) -> float:
    """Return how long step k takes, µs."""
    begin = time.perf_counter_ns()
    step(k)
    return (time.perf_counter_ns() - begin) / 1e3


def fastest(build: Callable[[str], Side], solvers: Sequence[str]) -> Side:
    """Return a fresh side with the fastest of the solvers here; one that fails is none."""
    medians = {}
    for solver in solvers:
        try:
            side = build(solver)
            times = [timed(side.step, k) for k in range(TRIAL)]
        except Exception as failure:  # each has exceptions of its own
            print(f"{solver}: {failure}")
            continue
        medians[solver] = np.median(times[TRIAL // 3 :])
    return build(min(medians, key=lambda solver: medians[solver]))


def matrices(work: Work) -> np.ndarray:
    """Return where each frame shall be at each step: (steps, frames, 4, 4)."""
    moves, poses = np.array(work["moves"]), np.array(work["poses"])
    found = np.zeros((len(moves), len(poses), 4, 4))
    w, x, y, z = poses[:, :4].T
    found[..., 0, 0], found[..., 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
    found[..., 0, 2], found[..., 1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
    found[..., 1, 1], found[..., 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    found[..., 2, 0], found[..., 2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
    found[..., 2, 2], found[..., 3, 3] = 1 - 2 * (x * x + y * y), 1.0
    found[..., :3, 3] = poses[:, 4:] + moves[:, None]
    return found


def points(work: Work) -> np.ndarray | None:
    """Return where the centre of mass shall be at each step (steps, 3), if it is a task."""
    return work["point"] + np.array(work["moves"]) if work["point"] else None
