"""Models and slopes for tasks below others."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import rmrc
from models import config
from rmrc.problem.evaluation import Evaluation

STEP = 1e-6
# Central differences err by STEP²·f''' ≈ 1e-12 and by rounding/STEP ≈ 1e-10 · the size of f ≤ 25.
CENTRAL_DIFFERENCE = 1e-8
# The same numbers from another order of additions.
ROUNDING = 1e-12


def written(folder: Path, text: str) -> str:
    path = folder / "scene.xml"
    path.write_text(text)
    return str(path)


def evaluation_of(scene: str, task: dict[str, Any], **others: Any) -> Evaluation:
    return Evaluation(rmrc.compile(config(scene, [{"name": "task", **task}], **others)))


def error_at(evaluation: Evaluation, q: np.ndarray) -> np.ndarray:
    evaluation.update(q)
    evaluation.evaluate()
    return evaluation.error.copy()


def slope(evaluation: Evaluation, potential: Any, q: np.ndarray) -> np.ndarray:
    """Return the derivatives (nv,) of a function of the kinematics along the tangent space."""
    model, found = evaluation.model, []
    for direction in np.eye(model.nv):
        ends = []
        for sign in (1.0, -1.0):
            moved = q.copy()
            mujoco.mj_integratePos(model, moved, direction, sign * STEP)
            evaluation.update(moved)
            ends.append(potential(evaluation.data))
        found.append((ends[0] - ends[1]) / (2 * STEP))
    return np.array(found)


def signed_distance(data: mujoco.MjData, first: str, second: str) -> float:
    model = data.model
    ids = model.geom(first).id, model.geom(second).id
    return mujoco.mj_geomDistance(model, data, *ids, 10.0, None)
