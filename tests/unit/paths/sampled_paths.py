"""Paths sampled over time, and files of them."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rmrc.paths import Trajectory

Array = NDArray[np.float64]

# What a target hits to rounding: a few units in the last place of numbers near 1.
EXACT = 1e-12
# Central differences over ±STEP: truncation is about STEP² times the third derivative (below 1e3
# here), rounding about 1e-16/STEP.
STEP = 1e-5
DIFFERENCE = 1e-6
START = np.array([0.5, 0.1, 0.4, 0.5, 0.5, -0.5, 0.5])
COORDINATES = ("world", "start")


def sample(trajectory: Trajectory, time: float) -> tuple[Array, Array]:
    """The pose and the twist at a time, every element written by the trajectory."""
    pose, twist = np.full(7, np.nan), np.full(6, np.nan)
    trajectory.sample(time, pose, twist)
    return pose, twist


def rotation(pose: Array) -> Rotation:
    return Rotation.from_quat(np.roll(pose[3:], -1))


def gap(pose: Array, other: Array) -> float:
    """The larger of the distance and the angle between two poses."""
    angle = (rotation(pose) * rotation(other).inv()).magnitude()
    return max(float(np.linalg.norm(pose[:3] - other[:3])), float(angle))


def difference(trajectory: Trajectory, time: float) -> Array:
    """The twist by central differences of the pose."""
    (before, _), (after, _) = sample(trajectory, time - STEP), sample(trajectory, time + STEP)
    turn = (rotation(after) * rotation(before).inv()).as_rotvec()
    return np.concatenate([after[:3] - before[:3], turn]) / (2 * STEP)
