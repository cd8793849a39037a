"""The collision limit: which pairs it has, what it measures, when it limits the motion."""

import mujoco
import numpy as np
import pytest
from collision_scenes import (
    DEEP_TOLERANCE,
    DISTANCE_TOLERANCE,
    SLOPE_TOLERANCE,
    STEP,
    barrier,
    kinematics,
    members,
    turned,
    zoo,
)

from models import REPOSITORY, random_configuration, random_quaternion
from rmrc.config.compiled_scene import load_model
from rmrc.limits import collision
from rmrc.limits.collision import LEAVE, Collision, collision_pairs
from rmrc.limits.models import CollisionLimit
from rmrc.model import distance


def brute_force(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Return every distance, of a capsule through a box too."""
    return np.array(
        [
            distance.signed_distance(
                model, data, (a, b, distance.is_capsule_and_box(model, a, b)), 10.0, np.empty(6)
            )
            for a, b in geoms.tolist()
        ]
    )


# What the barrier gives.

SCENES = ["planar_3r", "panda", "biped", "dual_arm", "mobile_arm"]


def check_slopes(model: mujoco.MjModel, limit: Collision, start: np.ndarray, count: int) -> None:
    data, rng, checked = mujoco.MjData(model), np.random.default_rng(0), 0
    for _ in range(count):
        q = random_configuration(model, start, rng, 0.4)
        data.qpos = q
        kinematics(model, data)
        near = limit.near(data, np.full(model.nv, 1e-3), 1e-3)
        np.testing.assert_allclose(near.distance, limit.distances(data, near.ids), atol=1e-12)
        assert (np.diff(near.ids) > 0).all()
        for dof in range(model.nv):
            sides = []
            for step in (STEP, -STEP):
                data.qpos = q
                mujoco.mj_integratePos(model, data.qpos, np.eye(model.nv)[dof], step)
                mujoco.mj_kinematics(model, data)
                sides.append(limit.distances(data, near.ids))
            slope = (sides[0] - sides[1]) / (2.0 * STEP)
            np.testing.assert_allclose(near.slope[:, dof], slope, atol=SLOPE_TOLERANCE)
            checked += slope.size
    assert checked > 50


@pytest.mark.parametrize("scene", [*SCENES, "zoo"])
def test_slopes_are_the_derivatives_of_the_distances(scene: str) -> None:
    model = zoo() if scene == "zoo" else load_model(f"scenes/{scene}.xml", REPOSITORY)
    limit, _ = barrier(model, detect=0.2)
    check_slopes(model, limit, model.key_qpos[0] if model.nkey else model.qpos0, 4)


@pytest.mark.parametrize("robot", ["aloha", "unitree_g1"])
def test_slopes_of_a_real_robot(menagerie: object, robot: str) -> None:
    model = load_model(f"menagerie:{robot}/scene", REPOSITORY)
    check_slopes(model, barrier(model)[0], model.key_qpos[0], 1)


def test_the_drift_is_that_of_the_obstacles() -> None:
    model = zoo()
    data, rng, twist = mujoco.MjData(model), np.random.default_rng(1), np.zeros((1, 6))
    limit, geoms = barrier(model, twist, detect=3.0)
    obstacle = members(model, geoms, "ball", "pole") == 1
    for _ in range(5):
        data.qpos = random_configuration(model, model.qpos0, rng, 0.4)
        position, turn = rng.normal(size=3), random_quaternion(rng)
        twist[:] = rng.normal(size=6)
        data.mocap_pos[0], data.mocap_quat[0] = position, turn
        kinematics(model, data)
        near = limit.near(data, np.full(model.nv, 1e-3), 1e-3)
        assert obstacle[near.ids].any()
        sides = []
        for step in (STEP, -STEP):
            data.mocap_pos[0] = position + step * twist[0, :3]
            data.mocap_quat[0] = turned(turn, twist[0, 3:], step)
            mujoco.mj_kinematics(model, data)
            sides.append(limit.distances(data, near.ids))
        rate = (sides[0] - sides[1]) / (2.0 * STEP)
        np.testing.assert_allclose(near.drift, rate, atol=SLOPE_TOLERANCE)
        assert (near.drift[~obstacle[near.ids]] == 0.0).all()


class Motions:
    """Steps, jumps, rests, and moves of the obstacle, of the size of a real motion and larger."""

    def __init__(self, model: mujoco.MjModel, seed: int):
        self.model, self.rng = model, np.random.default_rng(seed)
        self.data = mujoco.MjData(model)
        self.start = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
        self.data.qpos = self.start
        kinematics(model, self.data)

    def next(self) -> mujoco.MjData:
        model, data, rng = self.model, self.data, self.rng
        kind = rng.integers(12)
        if kind == 0:  # a jump of everything
            data.qpos = random_configuration(model, self.start, rng, 1.5)
        elif kind == 1 and model.nmocap:  # a jump of the obstacle alone
            data.mocap_pos += rng.normal(size=data.mocap_pos.shape) * 0.3
            data.mocap_quat[0] = random_quaternion(rng)
        elif kind > 3:  # otherwise it rests
            size = rng.choice([1e-3, 1e-2, 0.1])
            mujoco.mj_integratePos(model, data.qpos, rng.uniform(-size, size, model.nv), 1.0)
            data.mocap_pos += rng.normal(size=data.mocap_pos.shape) * size
        kinematics(model, data)
        return data


@pytest.mark.parametrize("scene", ["zoo", "planar_4r", "panda", "mobile_arm", "biped"])
def test_the_active_pairs_are_those_of_measuring_all(scene: str) -> None:
    model = zoo() if scene == "zoo" else load_model(f"scenes/{scene}.xml", REPOSITORY)
    limit, geoms = barrier(model)
    motions, ids = Motions(model, 0), np.arange(len(geoms))
    active, entered, left = np.zeros(len(geoms), dtype=bool), 0, 0
    for k in range(150):
        data, dt = motions.next(), 1e-3
        travel = motions.rng.choice([1e-3, 3e-3, 0.03]) * motions.rng.random(model.nv)
        near = limit.near(data, travel, dt)
        d = brute_force(model, data, geoms)
        threshold = np.maximum(0.05, 0.01 + limit.reach(ids, travel, dt))
        now = np.where(active, d <= LEAVE * threshold, d <= threshold)
        entered, left = entered + (now & ~active).sum(), left + (active & ~now).sum()
        active = now
        assert near.ids.tolist() == np.flatnonzero(active).tolist()
        np.testing.assert_array_equal(near.distance, d[active] - 0.01)
        if k % 3 == 0:
            data = motions.next() if k % 2 else data
            d = brute_force(model, data, geoms)
            least, pair = limit.least(data)
            if d.min() < 0.05:
                assert least == d.min() - 0.01
                assert d[pair] == d.min()
            else:
                assert 0.04 <= least <= d.min() - 0.01
    assert entered > 2
    assert left > 2


def test_far_pairs_are_seldom_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model("scenes/dual_arm.xml", REPOSITORY)
    limit, geoms = barrier(model)
    measured: list[object] = []

    def counted(model, data, pair, most, segment):  # type: ignore[no-untyped-def]
        measured.append(pair)
        return distance.signed_distance(model, data, pair, most, segment)

    monkeypatch.setattr(collision, "signed_distance", counted)
    data, rows, steps = mujoco.MjData(model), 0, 200
    data.qpos = model.key_qpos[0]
    for _ in range(steps):
        mujoco.mj_integratePos(model, data.qpos, np.full(model.nv, 0.5), 1e-3)
        kinematics(model, data)
        rows += limit.near(data, np.full(model.nv, 3e-3), 1e-3).ids.size
    # Active pairs are measured at every step, all the others together less than one of them.
    assert len(geoms) > 900
    assert len(measured) - rows < 2 * steps


def test_hysteresis() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="wall" type="box" size="0.1 1 1" pos="-0.1 0 0"/>
        <body name="cart"><joint type="slide" axis="1 0 0"/><geom name="cart" size="0.1"/></body>
        </worldbody></mujoco>"""
    )
    limit, _ = barrier(model, d_min=0.02, detect=0.05)
    data = mujoco.MjData(model)

    def active(d: float, travel: float = 1e-3) -> bool:
        data.qpos[0] = d + 0.1
        kinematics(model, data)
        return limit.near(data, np.array([travel]), 1e-3).ids.size == 1

    chatter = [active(0.05 + 0.005 * (-1) ** k) for k in range(20)]
    assert chatter == [False] + [True] * 19
    assert active(0.0599)
    assert not active(0.0601)
    assert not active(0.0501)
    assert active(0.0499)
    # What a step can take off the distance counts: 0.02 + 0.1 m before d_min.
    assert active(0.115, travel=0.1)
    assert not active(0.145, travel=0.1)


def test_no_step_takes_more_than_the_reach() -> None:
    model, rng = zoo(), np.random.default_rng(2)
    twist = np.zeros((1, 6))
    limit, geoms = barrier(model, twist)
    data, ids, closest = mujoco.MjData(model), np.arange(len(geoms)), np.inf
    slide = model.joint("extend").qposadr[0]
    for _ in range(300):
        q = random_configuration(model, model.qpos0, rng, 1.0)
        q[slide] = rng.uniform(*model.joint("extend").range)
        data.qpos = q
        data.mocap_pos[0], data.mocap_quat[0] = rng.normal(size=3), random_quaternion(rng)
        mujoco.mj_kinematics(model, data)
        before = limit.distances(data, ids)
        step = rng.uniform(-0.2, 0.2, model.nv) * (rng.random(model.nv) < 0.3)
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
        data.qpos[slide] = np.clip(data.qpos[slide], *model.joint("extend").range)
        twist[:] = rng.normal(size=6) * (rng.random() < 0.3)
        dt = 0.1
        data.mocap_pos[0] += dt * twist[0, :3]
        mujoco.mju_quatIntegrate(data.mocap_quat[0], twist[0, 3:], dt)
        mujoco.mj_kinematics(model, data)
        room = limit.reach(ids, step, dt) - (before - limit.distances(data, ids))
        # The distance of the solver is off by up to the tolerance for deep overlaps.
        assert room.min() > -DEEP_TOLERANCE
        closest = min(closest, room[before > 0].min())
    assert closest > -DISTANCE_TOLERANCE


def test_the_reach_is_that_of_the_longest_arm() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="wall" type="box" size="1 1 1" pos="5 0 0"/>
        <body><joint axis="0 0 1" pos="0 0.1 0"/><geom name="hub" size="0.1"/>
        <body name="end" pos="0.2 0 0">
        <joint type="slide" axis="1 0 0" range="-0.1 0.3" limited="true"/><geom size="0.05"/>
        </body></body></worldbody></mujoco>"""
    )
    limit, _ = barrier(model, pairs=[("wall", "end")])
    reach = limit.reach(np.array([0]), np.array([-0.01, 0.0]), 1e-3)
    assert reach[0] == pytest.approx(0.01 * (0.05 + 0.3 + 0.2 + 0.1))
    assert limit.reach(np.array([0]), np.array([0.0, 0.02]), 1e-3)[0] == pytest.approx(0.02)


def test_a_state_without_numbers_is_forgotten() -> None:
    model = load_model("scenes/panda.xml", REPOSITORY)
    (limit, _), (fresh, _) = barrier(model), barrier(model)
    data, travel = mujoco.MjData(model), np.full(model.nv, 3e-3)
    for q in (model.key_qpos[0], np.full(model.nq, np.nan), model.key_qpos[0]):
        data.qpos = q
        kinematics(model, data)
        near = limit.near(data, travel, 1e-3)
    expected = fresh.near(data, travel, 1e-3)
    assert near.ids.tolist() == expected.ids.tolist()
    np.testing.assert_array_equal(near.slope, expected.slope)


def test_a_dof_without_a_limit_counts_where_it_moves_a_pair() -> None:
    model = zoo()
    limit, geoms = barrier(model)
    data, travel = mujoco.MjData(model), np.full(model.nv, 1e-3)
    travel[model.joint("tail").dofadr[0]] = np.inf
    kinematics(model, data)
    near = limit.near(data, travel, 1e-3)
    moved = members(model, geoms, "tail", "rattle") == 1  # and not both of them
    assert near.ids.tolist() == np.flatnonzero(moved).tolist()


def test_thickness() -> None:
    model = zoo()
    limit, geoms = barrier(model, d_min=0.001)
    thin = {
        "floor": np.inf, "wall": 0.05, "ball": 0.1, "pole": 0.03, "trunk": 0.05,
        "upper": 0.03, "fore": 0.03, "": 0.02, "tip": 0.01, "tail": 0.02, "rattle": 0.04,
    }  # fmt: skip
    expected = [min(thin[model.geom(g).name] for g in pair) + 0.001 for pair in geoms.tolist()]
    np.testing.assert_allclose(limit.thickness(np.arange(len(geoms))), expected, atol=1e-9)


def test_neighbours_that_are_always_near_are_left_out_and_said(menagerie: object) -> None:
    model = load_model("menagerie:franka_emika_panda/panda", REPOSITORY)
    pairs, notices = collision_pairs(model, CollisionLimit(d_min=0.01))
    bodies = {frozenset(model.geom_bodyid[list(pair)]) for pair in pairs.geoms}
    assert frozenset((model.body("link0").id, model.body("link1").id)) not in bodies
    assert any("nearer than d_min wherever the joints are" in notice for notice in notices)
    closer, _ = collision_pairs(model, CollisionLimit(d_min=0.0))
    assert len(closer.geoms) > len(pairs.geoms)
