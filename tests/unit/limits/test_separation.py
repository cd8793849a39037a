"""Planes between geoms: what they say of distances elsewhere is never too much."""

import mujoco
import numpy as np
import pytest

from models import REPOSITORY, random_configuration
from rmrc.config.compiled_scene import load_model
from rmrc.limits.collision import BLURRED, Collision, collision_pairs
from rmrc.limits.models import CollisionLimit

# The planes are lowered by BLURRED against a solver that is exact to 1e-6 m.
TOLERANCE = 0.01 * BLURRED
SCENES = ("dual_arm", "biped", "panda_obstacle", "mobile_arm")
LENGTH, PLACES = 0.1, 16  # s of a motion, and where it is looked at


class Pairs:
    """All pairs of a scene at a configuration, with the planes that they have there."""

    def __init__(self, scene: str, rng: np.random.Generator):
        self.model = load_model(f"scenes/{scene}.xml", REPOSITORY)
        spec, _ = collision_pairs(self.model, CollisionLimit())
        self.data, self._rng = mujoco.MjData(self.model), rng
        self.barrier: Collision = spec.build(self.model, np.zeros((self.model.nmocap, 6)))
        self.q = random_configuration(self.model, self.model.qpos0, rng, 1.0)
        self.place(np.zeros(self.model.nv))
        self.near = self.barrier.near(self.data, np.full(self.model.nv, 10.0), 1.0)
        self.planes = self.barrier.planes(self.data, self.near.ids)
        self.every = np.arange(self.near.ids.size)

    def place(self, way: np.ndarray) -> None:
        """Move the joints by a way (nv,) from where they were."""
        self.data.qpos[:] = self.q
        mujoco.mj_integratePos(self.model, self.data.qpos, way, 1.0)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def motion(self) -> np.ndarray:
        """Return speeds (nv,) of some of the joints."""
        moving = self._rng.random(self.model.nv) < 0.5
        return self._rng.uniform(-3.0, 3.0, self.model.nv) * moving

    def known(self) -> np.ndarray:
        return self.planes.least(self.data, self.every)

    def distances(self) -> np.ndarray:
        return self.barrier.distances(self.data, self.near.ids)


@pytest.mark.parametrize("scene", SCENES)
def test_what_planes_say_is_never_more_than_the_distance(scene: str) -> None:
    rng, told = np.random.default_rng(0), 0
    for _ in range(15):
        pairs = Pairs(scene, rng)
        np.testing.assert_allclose(pairs.known(), pairs.planes.distance, rtol=0, atol=1e-12)
        for share in (0.01, 0.05, 0.2):
            pairs.place(share * pairs.motion())
            known = pairs.known()
            assert (known <= pairs.distances() + TOLERANCE).all()
            told += np.count_nonzero(known > 0.0)
    assert told > 100  # else they would say nothing


@pytest.mark.parametrize("scene", SCENES)
def test_no_path_bends_further_than_its_bound(scene: str) -> None:
    rng, told = np.random.default_rng(0), 0
    for _ in range(15):
        pairs = Pairs(scene, rng)
        speed, change = pairs.motion(), np.abs(pairs.motion()) * 5.0
        # Braking that no joint ends: v t − a t²/2 with a at most v/t.
        change = np.minimum(change, np.abs(speed) / LENGTH) * np.sign(speed)
        ways = [t * speed - 0.5 * t * t * change for t in np.linspace(0.0, LENGTH, PLACES + 1)]
        reach = pairs.barrier.reach(pairs.near.ids, np.abs(ways[-1]), 0.0)
        _, levers, moves = pairs.barrier.motion(pairs.near.ids, reach)
        swift = np.abs(speed)
        bend = levers @ np.abs(change) + (levers @ swift) * (moves @ swift)
        pairs.place(ways[-1])
        ends = np.minimum(pairs.planes.distance, pairs.known())
        least = ends - bend * (LENGTH**2 / 8.0)
        for way in ways[1:-1]:
            pairs.place(way)
            assert (pairs.distances() >= least - TOLERANCE).all()
        told += np.count_nonzero(least > 0.0)
    assert told > 100
