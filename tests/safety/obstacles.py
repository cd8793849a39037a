"""The robots of the matrix beside a ball and a wall, and how near geoms come to one another."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from matrix import ROBOTS, Robot
from numpy.typing import NDArray

import rmrc
from rmrc.limits.collision import CollisionPairs
from rmrc.model.distance import signed_distance

Array = NDArray[np.float64]

BALL, WALL = "ball", "wall"
"""The names of the mocap bodies and of their geoms."""
RADIUS = 0.05  # m
PLATE = (0.5, 0.5, 5e-4)
"""Half lengths of the wall, m: it is 1 mm thick."""
AWAY = (0.0, 0.0, 10.0)
"""Where the ball is in the scene, m; the wall is twice as high."""
LOOK = 0.2
"""Distance in m from which on it does not matter to a test how far two geoms are apart."""


def beside_a_ball(name: str, folder: Path) -> Robot:
    """Return a robot in a scene that has a mocap ball, too; the scene is written once a folder."""
    robot, path = ROBOTS[name], folder / f"{name}.xml"
    if not path.exists():
        scene = _scene_file(robot.scene)
        spec = mujoco.MjSpec.from_file(str(scene))
        spec.meshdir = str(scene.parent / spec.meshdir)
        spec.texturedir = str(scene.parent / spec.texturedir)
        ball = spec.worldbody.add_body(name=BALL, mocap=True, pos=AWAY)
        ball.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0.0, 0.0])
        wall = spec.worldbody.add_body(name=WALL, mocap=True, pos=[0.0, 0.0, 2.0 * AWAY[2]])
        wall.add_geom(name=WALL, type=mujoco.mjtGeom.mjGEOM_BOX, size=PLATE)
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

    def of(self, geom: str) -> NDArray[np.intp]:
        """Return the numbers of the pairs that a geom is of."""
        return np.flatnonzero((self.pairs == self._model.geom(geom).id).any(axis=1))

    def at(
        self, q: Array, data: mujoco.MjData, chosen: NDArray[np.intp] | slice = slice(None)
    ) -> Array:
        """Return d of some pairs at q, up to 0.2 m, with the mocap bodies where `data` has them."""
        model, own = self._model, self._data
        own.qpos[:], own.mocap_pos[:], own.mocap_quat[:] = q, data.mocap_pos, data.mocap_quat
        mujoco.mj_kinematics(model, own)
        pairs = self.pairs[chosen]
        first, second = pairs.T
        apart = np.linalg.norm(own.geom_xpos[first] - own.geom_xpos[second], axis=1)
        radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, np.inf)  # 0 for planes
        near = np.flatnonzero(apart - radius[first] - radius[second] < LOOK)
        distance = np.full(len(pairs), LOOK)
        for k in near.tolist():
            a, b = pairs[k].tolist()
            distance[k] = signed_distance(model, own, (a, b, False), LOOK, np.empty(6))
        return distance
