"""The robots of the matrix beside a ball that moves, and how near geoms come to one another."""

import os
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from matrix import ROBOTS, Robot
from numpy.typing import NDArray

import rmrc
from rmrc.problem.limits.collision import CollisionPairs

Array = NDArray[np.float64]

BALL = "ball"
"""The name of the mocap body and of its geom."""
RADIUS = 0.05  # m
AWAY = (0.0, 0.0, 10.0)
"""Where the ball is in the scene, m."""
LOOK = 0.2
"""Distance in m from which on it does not matter to a test how far two geoms are apart."""


def beside_a_ball(name: str, folder: Path) -> Robot:
    """Return a robot in a scene that has a mocap ball, too; the scene is written once a folder."""
    robot, path = ROBOTS[name], folder / f"{name}.xml"
    if robot.scene.startswith("menagerie:") and not os.environ.get("MENAGERIE_ROOT"):
        pytest.skip("needs the Menagerie's robots: set MENAGERIE_ROOT to a checkout")
    if not path.exists():
        scene = _scene_file(robot.scene)
        spec = mujoco.MjSpec.from_file(str(scene))
        spec.meshdir = str(scene.parent / spec.meshdir)
        spec.texturedir = str(scene.parent / spec.texturedir)
        ball = spec.worldbody.add_body(name=BALL, mocap=True, pos=AWAY)
        size = [RADIUS, 0.0, 0.0]
        ball.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size)
        spec.compile()
        path.write_text(spec.to_xml())
    return replace(robot, scene=str(path))


def _scene_file(scene: str) -> Path:
    if not scene.startswith("menagerie:"):
        return Path(scene)
    import mujoco_menagerie

    name, _, entry = scene.removeprefix("menagerie:").partition("/")
    return Path(mujoco_menagerie.get(name).xml(entry or None))


class Distances:
    """The distances of a problem's pairs of geoms, by a plain loop over all of them."""

    def __init__(self, problem: rmrc.Problem):
        self._model, self._data = problem.model, mujoco.MjData(problem.model)
        [pairs] = [limit for limit in problem.barriers if isinstance(limit, CollisionPairs)]
        self.pairs = pairs.geoms
        self.d_min = pairs.d_min

    def at(self, q: Array, obstacles: Array | None = None) -> Array:
        """Return d (p,) at q, up to 0.2 m, with the mocap bodies at the positions (nmocap, 3)."""
        model, data = self._model, self._data
        data.qpos[:] = q
        if obstacles is not None:
            data.mocap_pos[:] = obstacles
        mujoco.mj_kinematics(model, data)
        first, second = self.pairs.T
        apart = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, np.inf)  # 0 for planes
        near = np.flatnonzero(apart - radius[first] - radius[second] < LOOK)
        distance = np.full(len(self.pairs), LOOK)
        for k in near.tolist():
            a, b = self.pairs[k].tolist()
            distance[k] = mujoco.mj_geomDistance(model, data, a, b, LOOK, None)
        return distance
