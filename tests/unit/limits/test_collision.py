"""The collision limit: which pairs it has, what it measures, when it limits the motion."""

from itertools import combinations_with_replacement

import mujoco
import numpy as np
import pytest

from models import REPOSITORY, random_configuration, random_quaternion
from rmrc.config.compiled_scene import load_model
from rmrc.errors import ModelError
from rmrc.limits import collision
from rmrc.limits.collision import LEAVE, Collision, collision_pairs
from rmrc.limits.models import CollisionLimit
from rmrc.limits.pairs import resolve_pairs
from rmrc.model import distance
from rmrc.tasks.base import FieldError

# A central difference is off by the square of its step times a curvature, up to 1/mm³ at an edge,
# and by the iterative solver's 1e-10 m over the step.
STEP, SLOPE_TOLERANCE = 1e-5, 2e-5
# Analytic pairs and polytopes are exact; of smooth ones the solver's tolerance is 1e-6 m.
DISTANCE_TOLERANCE = 1e-6
# Of overlapping smooth geoms the solver is off by up to a hundredth of the depth; the normal too.
DEEP_TOLERANCE = 2e-3

CUBE = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.07, 0.07))

# Every kind of joint, an obstacle with an arm, and something for each filter to take out.
ZOO = f"""
<mujoco>
  <asset><mesh name="cube" vertex="{CUBE}"/>
    <hfield name="hill" nrow="2" ncol="2" size="1 1 0.1 0.1" elevation="0 1 1 0"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="hill" type="hfield" hfield="hill" pos="5 5 0"/>
    <geom name="wall" type="box" size="0.05 1 1" pos="-1.5 0 1"/>
    <body name="obstacle" mocap="true" pos="0.8 0 0.6">
      <geom name="ball" size="0.1"/>
      <body name="mast" pos="0 0 0.3" euler="0 20 0">
        <geom name="pole" type="capsule" size="0.03 0.15"/></body>
    </body>
    <body name="base" pos="0 0 0.8"><freejoint name="float"/>
      <geom name="trunk" type="mesh" mesh="cube"/>
      <geom name="skin" type="box" size="0.2 0.2 0.2" contype="0" conaffinity="0"/>
      <body name="upper" pos="0.12 0 0.05"><joint name="shoulder" type="ball" pos="0 0.01 0"/>
        <geom name="upper" type="cylinder" size="0.03 0.1" pos="0.1 0 0" euler="0 90 0"/>
        <body name="fore" pos="0.25 0 0"><joint name="extend" type="slide" axis="1 0 0"
            range="-0.05 0.1" limited="true"/>
          <joint name="elbow" axis="0 1 0" pos="-0.02 0 0"/>
          <geom name="fore" type="ellipsoid" size="0.12 0.03 0.04" pos="0.1 0 0"/>
          <geom type="sphere" size="0.02" pos="0.25 0 0"/>
          <body name="fixed" pos="0.28 0 0">
            <geom name="tip" type="box" size="0.02 0.03 0.01"/></body>
        </body>
      </body>
      <body name="tail" pos="-0.12 0 0"><joint name="tail" axis="0 1 0"/>
        <geom name="tail" type="capsule" size="0.02 0.15" pos="-0.2 0 0" euler="0 90 0"/>
        <body name="rattle" pos="-0.4 0 0"><joint axis="0 0 1"/>
          <geom name="rattle" size="0.04" contype="2" conaffinity="2"/></body>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="tail" body2="fore"/><pair geom1="rattle" geom2="wall"/></contact>
</mujoco>
"""


def zoo() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ZOO)


def kinematics(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def named(model: mujoco.MjModel, **limit: object) -> tuple[set[tuple[str, str]], list[str]]:
    """Return the pairs of a limit by the names of the geoms, and the notices."""
    pairs, notices = resolve_pairs(model, CollisionLimit.model_validate(limit))
    found = {tuple(sorted(model.geom(g).name for g in pair)) for pair in pairs.tolist()}
    assert len(found) == len(pairs)
    return found, notices  # type: ignore[return-value]


def barrier(
    model: mujoco.MjModel, twist: np.ndarray | None = None, **limit: object
) -> tuple[Collision, np.ndarray]:
    spec, _ = collision_pairs(model, CollisionLimit.model_validate(limit))
    return spec.build(model, np.zeros((model.nmocap, 6)) if twist is None else twist), spec.geoms


def members(model: mujoco.MjModel, geoms: np.ndarray, *names: str) -> np.ndarray:
    """Return how many geoms of each pair have one of the names."""
    return np.isin(geoms, [model.geom(name).id for name in names]).astype(int).sum(axis=1)


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


# Which pairs there are.


def collided(model: mujoco.MjModel) -> set[tuple[int, ...]]:
    """Return what MuJoCo collides, with margins so large that all geoms are in contact.

    In one configuration it may find no contact of boxes that are far apart; in twenty it does.
    """
    model.geom_margin[:] = model.body_margin[:] = model.pair_margin[:] = 100.0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    found = set()
    for _ in range(20):
        data.qpos = random_configuration(model, model.qpos0, rng, 2.0)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found |= {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
    return found


@pytest.mark.parametrize("scene", ["zoo", "planar_4r", "panda", "mobile_arm"])
def test_all_is_what_mujoco_would_let_collide(scene: str) -> None:
    model = zoo() if scene == "zoo" else load_model(f"scenes/{scene}.xml", REPOSITORY)
    pairs, _ = resolve_pairs(model, CollisionLimit())
    tree = model.dof_bodyid[0]  # all scenes have one robot; obstacles and the world do not count
    robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[tree]
    measured = model.geom_type != mujoco.mjtGeom.mjGEOM_HFIELD
    expected = {
        (a, b) for a, b in collided(model) if robot[[a, b]].any() and measured[[a, b]].all()
    }
    assert {tuple(sorted(pair)) for pair in pairs.tolist()} == expected
    assert (np.diff(model.geom_type[pairs], axis=1) >= 0).all()


def test_what_the_filters_take_out_is_said() -> None:
    found, notices = named(zoo())
    assert notices[0] == f"pairs of geoms that collision keeps apart: {len(found)}"
    said = "\n".join(notices)
    assert "geoms whose contype and conaffinity are 0 (1): skin" in said
    assert "pairs of a body and its parent (5): trunk – upper" in said
    assert "pairs that the scene excludes (2): fore – tail" in said
    assert "by contype and conaffinity (10): floor – rattle" in said
    assert "that MuJoCo cannot measure (6): hill – trunk" in said
    assert ("rattle", "wall") in found
    assert ("floor", "wall") not in found


def test_parents_are_filtered_as_the_scene_says() -> None:
    model = zoo()
    assert ("trunk", "upper") not in named(model)[0]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    found, notices = named(model)
    assert ("trunk", "upper") in found
    assert "parent" not in "\n".join(notices)


def test_a_pair_that_is_named_is_kept_where_it_moves() -> None:
    model = zoo()
    # Parent and child, excluded by the scene, and without contact: all three are meant.
    pairs = [("base", "upper"), ("tail", "tip"), ("tail", "fore"), ("skin", "tip")]
    found, notices = named(model, pairs=pairs)
    assert found == {
        ("trunk", "upper"), ("tail", "tip"), ("fore", "tail"), ("", "tail"), ("skin", "tip")
    }  # fmt: skip
    assert any("named bodies that collide with nothing (1): skin" in n for n in notices)


def test_groups_are_filtered_and_exclude_takes_out() -> None:
    groups = {"arm": ("upper", "fore", "fixed"), "body": ("base", "tail")}
    found, notices = named(
        zoo(), groups=groups, pairs=[("arm", "body")], exclude=[("tip", "base"), ("wall", "floor")]
    )
    assert found == {("fore", "trunk"), ("", "trunk"), ("tail", "upper"), ("tail", "tip")}
    said = "\n".join(notices)
    assert "pairs of a body and its parent (1): trunk – upper" in said
    assert "pairs that the scene excludes (2)" in said
    assert "pairs that `exclude` names (1): trunk – tip" in said
    assert "'wall' and 'floor' in `exclude` are no pair anyway" in said


@pytest.mark.parametrize(
    ("limit", "key", "message"),
    [
        ({"pairs": [("trunc", "wall")]}, "pairs", "did you mean 'trunk'"),
        ({"exclude": [("arm", "wall")], "groups": {"arms": ("fore",)}}, "exclude", "'arms'"),
        ({"groups": {"g": ("foe",)}, "pairs": [("g", "wall")]}, "groups", "did you mean 'fore'"),
        ({"pairs": [("fore", "tip")]}, "pairs", "no joint moves 'fore' and 'tip'"),
        ({"pairs": [("wall", "obstacle")]}, "pairs", "no joint moves 'wall' and 'obstacle'"),
        ({"pairs": [("hill", "tip")]}, "pairs", "MuJoCo cannot measure"),
        ({"pairs": [("tip", "wall")], "exclude": [("fixed", "wall")]}, "pairs", "no pair left"),
    ],
)
def test_names_that_mean_nothing_are_errors(
    limit: dict[str, object], key: str, message: str
) -> None:
    with pytest.raises(FieldError, match=message) as caught:
        resolve_pairs(zoo(), CollisionLimit.model_validate(limit))
    assert caught.value.key == key


def test_a_scene_without_nativeccd_is_refused() -> None:
    model = zoo()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    with pytest.raises(ModelError, match="nativeccd"):
        resolve_pairs(model, CollisionLimit())


def test_names_of_pairs() -> None:
    limit, geoms = barrier(zoo(), pairs=[("fore", "wall"), ("fore", "floor")])
    assert {limit.name(i) for i in range(len(geoms))} == {
        "fore – wall", "geom 1 of fore – wall", "floor – fore", "floor – geom 1 of fore"
    }  # fmt: skip


# What MuJoCo's distances hold.

SHAPES = {
    "plane": 'type="plane" size="0 0 1"',
    "sphere": 'size="0.1"',
    "capsule": 'type="capsule" size="0.05 0.15"',
    "ellipsoid": 'type="ellipsoid" size="0.05 0.1 0.15"',
    "cylinder": 'type="cylinder" size="0.08 0.12"',
    "box": 'type="box" size="0.06 0.1 0.14"',
    "mesh": 'type="mesh" mesh="cube"',
}
CONVEX = list(SHAPES)[1:]


def two_shapes(first: str, second: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    geoms = "".join(f'<body mocap="true"><geom {SHAPES[s]}/></body>' for s in (first, second))
    asset = f'<asset><mesh name="cube" vertex="{CUBE}"/></asset>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{asset}<worldbody>{geoms}</worldbody></mujoco>"
    )
    return model, mujoco.MjData(model)


def farthest(model: mujoco.MjModel, data: mujoco.MjData, geom: int, n: np.ndarray) -> float:
    """Return the most of nᵀx over a geom, in closed form."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    local = n @ data.geom_xmat[geom].reshape(3, 3)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        extent = 0.0 if local[2] > 1.0 - 1e-9 else np.inf
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        extent = size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        extent = size[0] + size[1] * abs(local[2])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        extent = np.linalg.norm(size * local)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        extent = size[0] * np.hypot(local[0], local[1]) + size[1] * abs(local[2])
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        extent = np.abs(local) @ size
    else:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        extent = (model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ local).max()
    return float(data.geom_xpos[geom] @ n + extent)


def gap(model: mujoco.MjModel, data: mujoco.MjData, n: np.ndarray) -> float:
    """Return the width of the slab along n between the two geoms: never more than their distance.

    Where they overlap it is minus the way along n that parts them.
    """
    return -farthest(model, data, 1, -n) - farthest(model, data, 0, n)


def place(data: mujoco.MjData, rng: np.random.Generator, least: float, most: float) -> None:
    """Turn both at random and put the second at a random place that far from the first."""
    data.mocap_quat[:] = [random_quaternion(rng), random_quaternion(rng)]
    way = rng.normal(size=3)
    data.mocap_pos[1] = way / np.linalg.norm(way) * rng.uniform(least, most)
    mujoco.mj_kinematics(data.model, data)


def turned(quaternion: np.ndarray, velocity: np.ndarray, dt: float) -> np.ndarray:
    """Return a rotation (4,) after turning at an angular velocity in the world."""
    rotation, result = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(4)
    mujoco.mju_quatIntegrate(rotation, velocity, dt)
    mujoco.mju_mulQuat(result, rotation, quaternion)
    return result


@pytest.mark.parametrize(
    ("first", "second"),
    [("plane", shape) for shape in CONVEX] + list(combinations_with_replacement(CONVEX, 2)),
)
def test_the_nearest_points_prove_the_distance(first: str, second: str) -> None:
    """The slab between parallel planes through them is as wide as they are apart."""
    model, data = two_shapes(first, second)
    rng, segment, apart = np.random.default_rng(0), np.zeros(6), 0
    pair = (0, 1, distance.is_capsule_and_box(model, 0, 1))
    for _ in range(60):
        place(data, rng, 0.05, 0.5)
        d = distance.signed_distance(model, data, pair, 10.0, segment)
        between = segment[3:] - segment[:3]
        assert np.linalg.norm(between) == pytest.approx(abs(d), abs=DISTANCE_TOLERANCE)
        width = gap(model, data, between / d)
        apart += d > 0
        tolerance = DISTANCE_TOLERANCE if d > 0 else DEEP_TOLERANCE
        assert width == pytest.approx(d, abs=tolerance)
        swapped = np.zeros(6)
        assert mujoco.mj_geomDistance(model, data, 1, 0, 10.0, swapped) == pytest.approx(
            mujoco.mj_geomDistance(model, data, 0, 1, 10.0, segment), abs=DISTANCE_TOLERANCE
        )
        np.testing.assert_allclose(np.roll(swapped, 3), segment, atol=DISTANCE_TOLERANCE)
        # A cut-off changes nothing below it and is what is returned above it.
        for most in (0.02, 0.1):
            cut = distance.signed_distance(model, data, pair, most, segment)
            assert cut == (d if d < most else most)
    assert 10 < apart < 60


def test_hulls_that_are_apart_are_never_called_touching() -> None:
    """MuJoCo 3.3.5 to 3.10 said 0 of some meshes that were decimetres apart."""
    rng, segment = np.random.default_rng(7), np.zeros(6)
    for _ in range(20):
        clouds = [rng.normal(size=(20, 3)) * rng.uniform(0.02, 0.2, 3) for _ in range(2)]
        assets = "".join(
            f'<mesh name="{i}" vertex="{" ".join(map(str, cloud.ravel()))}"/>'
            for i, cloud in enumerate(clouds)
        )
        bodies = "".join(f'<body mocap="true"><geom type="mesh" mesh="{i}"/></body>' for i in "01")
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><asset>{assets}</asset><worldbody>{bodies}</worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        for _ in range(40):
            place(data, rng, 0.05, 1.0)
            d = distance.signed_distance(model, data, (0, 1, False), 10.0, segment)
            assert d != 0.0
            width = gap(model, data, (segment[3:] - segment[:3]) / d)
            assert width == pytest.approx(d, abs=DISTANCE_TOLERANCE)


def test_a_capsule_through_a_box_is_inside_it() -> None:
    """MuJoCo calls it apart; once this fails for `mj_geomDistance`, our own way can go."""
    model, data = two_shapes("capsule", "box")
    rng, segment, wrong = np.random.default_rng(0), np.zeros(6), 0
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for _ in range(200):
        place(data, rng, 0.0, 0.12)
        d = distance.signed_distance(model, data, (0, 1, True), 10.0, segment)
        width = gap(model, data, (segment[3:] - segment[:3]) / d)
        assert width == pytest.approx(d, abs=1e-9)
        # No direction parts them sooner.
        assert max(gap(model, data, n) for n in directions) <= d + 1e-9
        wrong += mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None) > d + 0.01
        # The nearest points give the derivative, here for a turn of the capsule.
        normal, turn = (segment[3:] - segment[:3]) / d, data.mocap_quat[0].copy()
        axis, sides = rng.normal(size=3), []
        for step in (STEP, -STEP):
            data.mocap_quat[0] = turned(turn, axis, step)
            mujoco.mj_kinematics(model, data)
            sides.append(distance.signed_distance(model, data, (0, 1, True), 10.0, np.empty(6)))
        slope = -normal @ np.cross(axis, segment[:3] - data.geom_xpos[0])
        assert (sides[0] - sides[1]) / (2.0 * STEP) == pytest.approx(slope, abs=SLOPE_TOLERANCE)
    assert wrong > 100


def test_the_cases_without_a_direction_have_one() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
        <geom name="rod" type="capsule" size="0.1 0.3" pos="0 0 1"/>
        <body name="slider"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="0 1 0"/>
        <geom name="bar" type="capsule" size="0.1 0.3" euler="0 90 0"/></body>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    limit, geoms = barrier(model, pairs=[("bar", "floor"), ("bar", "rod")])
    floor, rod = (int(members(model, geoms, name).argmax()) for name in ("floor", "rod"))

    def slope(height: float, aside: float, pair: int) -> list[float]:
        data.qpos[:] = height, aside
        kinematics(model, data)
        near = limit.near(data, np.full(2, 1e-3), 1e-3)
        return near.slope[near.ids == pair][0].tolist()

    assert slope(0.1, 0.0, floor) == pytest.approx([1.0, 0.0])  # touching, with no other known
    assert slope(1.2, -0.21, rod) == pytest.approx([0.0, -1.0])
    assert slope(1.2, -0.2, rod) == pytest.approx([0.0, -1.0])  # touching, away from the centres
    assert np.abs(slope(1.0, 0.0, rod)).tolist() == pytest.approx([0.0, 1.0])  # the axes cross


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
