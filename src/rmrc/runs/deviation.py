"""How far a frame was from the straight line that its target drew."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.lie import pose_of
from rmrc.paths import LinePath
from rmrc.problem.problem import Problem
from rmrc.runs.target_paths import build_aims
from rmrc.tasks.base import Term
from rmrc.tasks.frame import FrameTerm

Array = NDArray[np.float64]


def line_deviations(problem: Problem, q: Array) -> dict[str, Array]:
    """Return, for each `frame` task whose target draws a line, how far off it the frame was.

    Columns (N, 2) are the distance from the segment, m, and the angle to the orientation that the
    line has at the nearest point of the segment, rad.

    Args:
        problem: The problem.
        q: Configurations (N, nq).
    """
    found = {}
    for aim in build_aims(problem):
        term = aim.term
        if isinstance(term, FrameTerm) and isinstance(problem.config.targets[term.name], LinePath):
            ends = []
            for time in (0.0, aim.path.duration):
                aim.sample(time)
                ends.append(aim.pose.copy())
            found[term.name] = _deviation(problem.model, term, q, *ends)
    return found


def line_summary(term: Term, deviation: Array) -> dict[str, Any]:
    """Return rms and max of a deviation (N, 2), of those halves that the task has a weight for."""
    halves = [
        {"rms": float(np.sqrt(np.mean(column**2))), "max": float(column.max()), "unit": unit}
        for column, unit in zip(deviation.T, ("m", "rad"), strict=True)
        if unit in term.units and len(deviation)
    ]
    return halves[0] | ({"orientation": halves[1]} if len(halves) > 1 else {}) if halves else {}


def _deviation(model: mujoco.MjModel, term: FrameTerm, q: Array, begin: Array, end: Array) -> Array:
    data = mujoco.MjData(model)
    position, matrix = term.frame.views(data)
    along = end[:3] - begin[:3]
    length = float(along @ along)
    turn, apart, step, wanted = np.empty(3), np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_subQuat(turn, end[3:], begin[3:])
    angle = float(np.linalg.norm(turn))
    deviations = np.empty((len(q), 2))
    for k, row in enumerate(q):
        data.qpos = row
        mujoco.mj_kinematics(model, data)
        away = position - begin[:3]
        share = min(max(float(away @ along) / length, 0.0), 1.0) if length else 1.0
        off = away - share * along
        mujoco.mju_axisAngle2Quat(step, turn / angle if angle else turn, share * angle)
        mujoco.mju_mulQuat(wanted, begin[3:], step)
        mujoco.mju_subQuat(apart, pose_of(matrix, position)[:4], wanted)
        deviations[k] = np.sqrt(off @ off), np.sqrt(apart @ apart)
    return deviations
