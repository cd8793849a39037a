"""The distance of two geoms, against their own supports."""

from itertools import combinations_with_replacement

import mujoco
import numpy as np
import pytest
from collision_scenes import (
    CUBE,
    DEEP_TOLERANCE,
    DISTANCE_TOLERANCE,
    SLOPE_TOLERANCE,
    STEP,
    barrier,
    kinematics,
    members,
    turned,
)

from models import random_quaternion
from rmrc.model import distance

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
