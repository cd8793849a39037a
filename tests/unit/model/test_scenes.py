"""The scenes: sound models at home, with the forward kinematics of the published figures."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

SCENES = Path(__file__).resolve().parents[3] / "scenes"
SITES = {
    "planar_2r": ["hand"],
    "planar_3r": ["hand"],
    "planar_4r": ["hand"],
    "panda": ["flange", "hand"],
    "panda_obstacle": ["flange", "hand"],
    "ur5e": ["tool"],
    "dual_arm": ["left_hand", "right_hand", "left_flange", "right_flange"],
    "mobile_arm": ["base", "arm_hand", "arm_flange"],
    "biped": ["left_foot", "right_foot", "left_hand", "right_hand", "torso", "pelvis", "head"],
    "four_bar": ["coupler_point", "coupler_end", "rocker_end"],
}
PANDA_ARM = [f"joint{i}" for i in range(1, 8)]
JOINTS = {
    "planar_2r": ["joint1", "joint2"],
    "planar_3r": ["joint1", "joint2", "joint3"],
    "planar_4r": ["joint1", "joint2", "joint3", "joint4"],
    "panda": PANDA_ARM,
    "panda_obstacle": PANDA_ARM,
    "ur5e": [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ],
    "dual_arm": [f"{side}_{joint}" for side in ("left", "right") for joint in PANDA_ARM],
    "mobile_arm": ["base_x", "base_y", "base_yaw", *(f"arm_{joint}" for joint in PANDA_ARM)],
    "four_bar": ["crank", "coupler", "rocker"],
}

# Franka's modified parameters: a and alpha of the row before the joint's rotation, d of its own.
PANDA_A = [0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088]
PANDA_ALPHA = np.pi / 2 * np.array([0, -1, 1, 1, -1, 1, 1])
PANDA_D = [0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0]
PANDA_FLANGE = 0.107
PANDA_GRASP = 0.1034
PANDA_LIMITS = np.array(
    [
        [-2.8973, 2.8973],
        [-1.7628, 1.7628],
        [-2.8973, 2.8973],
        [-3.0718, -0.0698],
        [-2.8973, 2.8973],
        [-0.0175, 3.7525],
        [-2.8973, 2.8973],
    ]
)
# Universal Robots' standard parameters.
UR5E_A = [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
UR5E_ALPHA = np.pi / 2 * np.array([1, 0, 0, 1, -1, 0])
UR5E_D = [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]

# Two ways of multiplying the same lengths and rotations: rounding alone, with room to spare.
KINEMATICS_TOLERANCE = 1e-9
# A closed loop, a sole on the floor, a range inherited: rounding alone again, of one operation.
EXACT = 1e-12
# What a position servo under gravity may give way in the first second, in rad or m.
DRIFT = 0.05
# Contacts this shallow are geoms that touch, as soles and floor do.
PENETRATION = 1e-4
# A distance that a collision limit may be asked to keep, in m.
NEAR = 0.02
RANDOM_CONFIGURATIONS = 1000

State = tuple[mujoco.MjModel, mujoco.MjData]


def at_home(name: str) -> State:
    model = mujoco.MjModel.from_xml_path(str(SCENES / f"{name}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(params=SITES)
def scene(request: pytest.FixtureRequest) -> State:
    return at_home(request.param)


def random_configurations(model: mujoco.MjModel) -> np.ndarray:
    """Seeded configurations, uniform over the ranges of a model of limited hinges."""
    low, high = model.jnt_range.T
    rng = np.random.default_rng(0)
    return rng.uniform(low, high, size=(RANDOM_CONFIGURATIONS, model.nq))


def pose(data: mujoco.MjData, site: str) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = data.site(site).xmat.reshape(3, 3)
    matrix[:3, 3] = data.site(site).xpos
    return matrix


def screw(axis: int, angle: float, distance: float) -> np.ndarray:
    """Rotate about the axis (0 is x, 2 is z) and slide along it, as a (4, 4) transformation."""
    matrix = np.eye(4)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[first, second] = -np.sin(angle)
    matrix[second, first] = np.sin(angle)
    matrix[axis, 3] = distance
    return matrix


def test_no_scene_is_left_out_of_these_tests():
    assert {path.stem for path in SCENES.glob("*.xml")} == set(SITES)


def test_home_is_the_only_keyframe_and_lies_within_the_ranges(scene: State):
    model, data = scene
    assert model.nkey == 1
    for joint in map(model.joint, range(model.njnt)):
        if model.jnt_limited[joint.id]:
            low, high = joint.range
            assert low <= data.qpos[joint.qposadr[0]] <= high, joint.name


def test_home_holds_each_actuator_at_its_joint(scene: State):
    model, data = scene
    driven = model.actuator_trnid[:, 0]
    np.testing.assert_array_equal(data.ctrl, data.qpos[model.jnt_qposadr[driven]])
    assert [model.actuator(i).name for i in range(model.nu)] == [
        model.joint(i).name for i in driven
    ]


def test_every_limited_joint_has_an_actuator_of_the_same_range(scene: State):
    model, _ = scene
    limited = np.flatnonzero(model.jnt_limited)
    driven = model.actuator_trnid[:, 0]
    assert set(limited) <= set(driven)
    bounded = np.isin(driven, limited)
    np.testing.assert_array_equal(model.actuator_ctrllimited.astype(bool), bounded)
    # MuJoCo inherits a range as its middle and half its width.
    np.testing.assert_allclose(
        model.actuator_ctrlrange[bounded], model.jnt_range[driven[bounded]], atol=EXACT
    )


def test_bodies_that_move_have_mass_and_inertia(scene: State):
    model, _ = scene
    moving = np.flatnonzero(model.body_weldid != 0)
    for figures in (model.body_mass[moving], model.body_inertia[moving]):
        assert np.all(np.isfinite(figures))
        assert np.all(figures > 0)


def test_only_named_primitives_that_can_collide(scene: State):
    model, _ = scene
    assert model.nmesh == 0
    assert all(model.geom(i).name for i in range(model.ngeom))
    assert np.all(model.geom_contype & model.geom_conaffinity)


@pytest.mark.parametrize("name", JOINTS)
def test_joint_names(name: str):
    model, _ = at_home(name)
    assert [model.joint(i).name for i in range(model.njnt)] == JOINTS[name]


@pytest.mark.parametrize("name", SITES)
def test_site_names(name: str):
    model, _ = at_home(name)
    assert {model.site(i).name for i in range(model.nsite)} == set(SITES[name])


def test_nothing_is_in_collision_at_home(scene: State):
    model, data = scene
    clashes = [
        (model.geom(contact.geom1).name, model.geom(contact.geom2).name)
        for contact in data.contact
        if contact.dist < -PENETRATION
    ]
    assert clashes == []


def test_holds_still_under_its_actuators(scene: State):
    model, data = scene
    home = data.qpos.copy()
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    drift = np.empty(model.nv)
    mujoco.mj_differentiatePos(model, drift, 1.0, home, data.qpos)
    assert np.abs(drift).max() < DRIFT


def test_overview_frames_the_robot(scene: State):
    model, data = scene
    camera = data.camera("overview")
    robot = np.flatnonzero(model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
    seen = (data.geom_xpos[robot] - camera.xpos) @ camera.xmat.reshape(3, 3)
    x, y = (seen[:, :2] / -seen[:, 2:]).T / np.tan(np.radians(model.camera("overview").fovy / 2))
    assert np.all(seen[:, 2] < 0)
    assert np.all(np.abs(y) < 1)
    assert np.all(np.abs(x) < 4 / 3)  # the narrowest picture in use, 4 : 3
    # It fills at least a third of the height or width, too.
    assert max(np.ptp(y) / 2, np.ptp(x) / (8 / 3)) > 1 / 3


def test_joined_bodies_are_no_collision_pair(scene: State):
    model, data = scene
    # Joined bodies are always near one another; neither contacts nor limits may mind.
    model.body_margin[:] = model.geom_margin[:] = NEAR
    rng = np.random.default_rng(0)
    limited = model.jnt_limited.astype(bool)
    for _ in range(200):
        data.qpos[model.jnt_qposadr[limited]] = rng.uniform(*model.jnt_range[limited].T)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for bodies in model.geom_bodyid[data.contact.geom]:
            parent, child = sorted(bodies)
            assert parent == 0 or model.body_parentid[child] != parent, model.body(child).name


@pytest.mark.parametrize("name", ["panda", "ur5e", "dual_arm", "mobile_arm"])
def test_arms_carry_their_own_weight(name: str):
    _, data = at_home(name)
    assert np.abs(data.qfrc_bias).max() > 1.0
    np.testing.assert_allclose(data.qfrc_gravcomp, data.qfrc_bias, atol=KINEMATICS_TOLERANCE)


@pytest.mark.parametrize("links", [2, 3, 4])
def test_planar_arm_is_a_sum_of_unit_vectors(links: int):
    model, data = at_home(f"planar_{links}r")
    np.testing.assert_array_equal(model.jnt_range, [[-3.1, 3.1]] * links)
    jacobian = np.empty((3, links))
    for q in random_configurations(model):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian, None, model.site("hand").id)
        units = np.stack([np.cos(np.cumsum(q)), np.sin(np.cumsum(q))])
        hand = [*units.sum(axis=1), 0.0]
        np.testing.assert_allclose(data.site("hand").xpos, hand, atol=KINEMATICS_TOLERANCE)
        beyond = np.cumsum(units[:, ::-1], axis=1)[:, ::-1]  # from each joint to the hand
        expected = np.stack([-beyond[1], beyond[0], np.zeros(links)])
        np.testing.assert_allclose(jacobian, expected, atol=KINEMATICS_TOLERANCE)


@pytest.mark.parametrize("links", [2, 3, 4])
def test_planar_home_is_away_from_singularities(links: int):
    model, data = at_home(f"planar_{links}r")
    jacobian = np.empty((3, links))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("hand").id)
    assert np.linalg.svd(jacobian[:2], compute_uv=False)[-1] > 0.5


def test_panda_is_the_product_of_its_modified_dh_matrices():
    model, data = at_home("panda")
    grasp = screw(2, -np.pi / 4, PANDA_GRASP)
    for q in random_configurations(model):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        flange = np.eye(4)
        for a, alpha, d, angle in zip(PANDA_A, PANDA_ALPHA, PANDA_D, q, strict=True):
            flange = flange @ screw(0, alpha, a) @ screw(2, angle, d)
        flange = flange @ screw(2, 0.0, PANDA_FLANGE)
        np.testing.assert_allclose(pose(data, "flange"), flange, atol=KINEMATICS_TOLERANCE)
        np.testing.assert_allclose(pose(data, "hand"), flange @ grasp, atol=KINEMATICS_TOLERANCE)


def test_panda_agrees_with_the_menagerie(menagerie: Path):
    model, data = at_home("panda")
    other = mujoco.MjModel.from_xml_path(str(menagerie / "franka_emika_panda/panda_nohand.xml"))
    theirs = mujoco.MjData(other)
    np.testing.assert_array_equal(model.jnt_range, other.jnt_range)
    for q in random_configurations(model):
        data.qpos = theirs.qpos = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_kinematics(other, theirs)
        flange = data.site("flange")
        np.testing.assert_allclose(
            flange.xpos, theirs.site("attachment_site").xpos, atol=KINEMATICS_TOLERANCE
        )
        # The Menagerie turns its attachment by a rounded quaternion; link7 carries it exactly.
        np.testing.assert_allclose(
            flange.xmat, theirs.body("link7").xmat, atol=KINEMATICS_TOLERANCE
        )


def test_panda_has_the_published_limits():
    model, _ = at_home("panda")
    np.testing.assert_array_equal(model.jnt_range, PANDA_LIMITS)


def test_ur5e_is_the_product_of_its_standard_dh_matrices():
    model, data = at_home("ur5e")
    for q in random_configurations(model):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        tool = np.eye(4)
        for a, alpha, d, angle in zip(UR5E_A, UR5E_ALPHA, UR5E_D, q, strict=True):
            tool = tool @ screw(2, angle, d) @ screw(0, alpha, a)
        np.testing.assert_allclose(pose(data, "tool"), tool, atol=KINEMATICS_TOLERANCE)


def test_ur5e_joints_turn_twice_and_the_elbow_once():
    model, _ = at_home("ur5e")
    turns = np.array([2, 2, 1, 2, 2, 2]) * np.pi
    np.testing.assert_array_equal(model.jnt_range, np.stack([-turns, turns], axis=1))


@pytest.mark.parametrize(
    ("name", "site", "mount"),
    [
        ("dual_arm", "left_hand", [0.0, 0.32, 0.74]),
        ("dual_arm", "right_hand", [0.0, -0.32, 0.74]),
        ("mobile_arm", "arm_hand", [0.15, 0.0, 0.33]),
    ],
)
def test_attached_arms_are_the_panda_at_home(name: str, site: str, mount: list[float]):
    _, panda = at_home("panda")
    _, data = at_home(name)
    expected = pose(panda, "hand")
    expected[:3, 3] += mount
    np.testing.assert_allclose(pose(data, site), expected, atol=EXACT)


def test_mobile_base_may_turn_without_end():
    model, _ = at_home("mobile_arm")
    assert [bool(model.joint(name).limited) for name in ("base_x", "base_y", "base_yaw")] == [
        True,
        True,
        False,
    ]


def test_biped_has_25_joints_on_a_floating_base_and_weighs_50_kg():
    model, _ = at_home("biped")
    assert model.joint("root").type == mujoco.mjtJoint.mjJNT_FREE
    assert np.count_nonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) == model.nu == 25
    assert model.body_mass.sum() == pytest.approx(50.0)


def test_biped_is_the_same_left_and_right():
    model, data = at_home("biped")
    for name in ("foot", "hand"):
        left, right = data.site(f"left_{name}").xpos, data.site(f"right_{name}").xpos
        np.testing.assert_allclose(left, right * [1, -1, 1], atol=EXACT)
    for index in range(model.njnt):
        left = model.joint(index)
        if left.name.startswith("left_"):
            right = model.joint(left.name.replace("left_", "right_"))
            mirrored = -right.range[::-1] if left.axis[1] == 0 else right.range
            np.testing.assert_array_equal(left.range, mirrored)


def test_biped_stands_with_its_soles_on_the_floor_and_its_com_above_them():
    model, data = at_home("biped")
    com = data.subtree_com[model.body("pelvis").id]
    for side in ("left", "right"):
        sole = data.geom(f"{side}_foot")
        half_length, _, half_height = model.geom(f"{side}_foot").size
        assert abs(sole.xpos[2] - half_height) < EXACT
        np.testing.assert_allclose(sole.xmat.reshape(3, 3), np.eye(3), atol=EXACT)
        assert abs(com[0] - sole.xpos[0]) < half_length
    assert abs(com[1]) < EXACT


def test_four_bar_is_closed_at_home_and_at_qpos0():
    model, data = at_home("four_bar")
    assert model.equality("loop").type == mujoco.mjtEq.mjEQ_CONNECT
    for q in (data.qpos.copy(), model.qpos0):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        gap = data.site("coupler_end").xpos - data.site("rocker_end").xpos
        assert np.linalg.norm(gap) < EXACT


def test_four_bar_crank_turns_all_the_way_round():
    model, data = at_home("four_bar")
    start = data.joint("crank").qpos[0]
    gap = 0.0
    while data.time < 4.0:
        data.ctrl = start + min(2 * np.pi, np.pi * data.time)  # round in 2 s, then hold
        mujoco.mj_step(model, data)
        ends = data.site("coupler_end").xpos - data.site("rocker_end").xpos
        gap = max(gap, float(np.linalg.norm(ends)))
    assert data.joint("crank").qpos[0] == pytest.approx(start + 2 * np.pi, abs=DRIFT)
    assert data.joint("rocker").qpos[0] == pytest.approx(model.qpos0[2], abs=DRIFT)
    assert gap < 1e-3  # m; MuJoCo's equality is a stiff spring, not a rigid pin
