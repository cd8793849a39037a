"""rmrc's side: a controller, with the engine that is asked for."""

from typing import Literal

import numpy as np

import rmrc
from side import Side, Work, points

PACKAGES = ("rmrc", "mujoco")
"""Whose versions matter."""


def build(work: Work, engine: Literal["auto", "python", "native"]) -> Side:
    """Return the side for the work."""
    problem = rmrc.compile(rmrc.Config.model_validate(work["config"]))
    controller = rmrc.Controller(problem, engine=engine)
    moves = np.array(work["moves"])
    poses = [
        (name, list(moves + pose[4:]), np.array(pose[:4]))
        for name, pose in zip(work["names"], work["poses"], strict=True)
    ]
    com = points(work)
    centres = None if com is None else list(com)

    def step(k: int) -> np.ndarray:
        for name, positions, quaternion in poses:
            controller.set_target(name, positions[k], quaternion)
        if centres is not None:
            controller.set_target("com", centres[k])
        return controller.step().q

    return Side(step, lambda: controller.q, controller.engine.name)
