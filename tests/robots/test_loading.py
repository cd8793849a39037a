"""Whatever file a robot comes in, it loads; what cannot be had is left out and said."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

import rmrc
from descriptions import ARM, FINGERS, INERTIAL, TURN, joint, link
from models import config as made
from rmrc.errors import ModelError
from rmrc.model.scene import FLOATING_BASE, load_scene
from rmrc.text.source import Attachment, Source

Urdf = Callable[..., Path]
HERE = Path()

TETRAHEDRON = """solid t
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 0.1 0
vertex 0.1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 0.1 0 0
vertex 0 0 0.1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 0 0
vertex 0 0 0.1
vertex 0 0.1 0
endloop
endfacet
facet normal 1 1 1
outer loop
vertex 0.1 0 0
vertex 0 0.1 0
vertex 0 0 0.1
endloop
endfacet
endsolid t
"""
"""A STL file that is text, which MuJoCo does not read."""


def with_mesh(uri: str) -> str:
    mesh = f'<geometry><mesh filename="{uri}"/></geometry>'
    return ARM.replace(
        link("l1"), link("l1", f"{INERTIAL}<visual>{mesh}</visual><collision>{mesh}</collision>")
    )


def test_fixed_links_speeds_and_efforts_are_kept(urdf: Urdf) -> None:
    scene = load_scene(str(urdf(ARM)), HERE)
    assert scene.model.body("tool0").pos.tolist() == [0.6, 0.0, 0.0]
    assert scene.velocity == {"j1": 0.5, "j2": 0.5}
    assert scene.model.jnt_actfrcrange.tolist() == [[-10.0, 10.0]] * 2
    assert scene.notices == ()


def test_a_mimic_is_an_equality_named_by_its_joints(urdf: Urdf) -> None:
    model = load_scene(str(urdf(ARM, FINGERS)), HERE).model
    assert model.equality(0).name == "f2 mimics f1"
    data = mujoco.MjData(model)
    data.joint("f1").qpos = data.joint("f2").qpos = 0.02
    mujoco.mj_forward(model, data)
    assert data.ne == 1
    assert data.efc_pos[0] == 0.0


def test_a_joint_that_has_to_stand_is_held(urdf: Urdf) -> None:
    still = ARM.replace('lower="-2" upper="2"', 'lower="0.3" upper="0.3"', 1)
    scene = load_scene(str(urdf(still)), HERE)
    assert scene.model.joint("j1").range.tolist() == [0.3, 0.3]
    assert scene.model.joint("j1").limited
    config = made(
        scene=str(urdf(still)),
        tasks=[{"name": "hand", "type": "frame", "frame": "tool0", "B": {"orientation": 0.0}}],
        limits={"position": {"margin": 0.01}},
        duration=0.5,
    )
    assert set(rmrc.solve(config).q[:, 0]) == {0.3}


def test_soft_limits_are_the_range(urdf: Urdf) -> None:
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1.5" k_velocity="1"/>'
    parts = ARM.replace(TURN, TURN + soft, 1)
    assert load_scene(str(urdf(parts)), HERE).model.joint("j1").range.tolist() == [-1.0, 1.5]


def test_a_floating_joint_floats_where_it_is(urdf: Urdf) -> None:
    floating = joint("root", "floating", "mount", "base", at="0 0 1")
    mount = joint("up", "fixed", "world", "mount", at="0 0 0.5")
    model = load_scene(
        str(urdf(link("world", ""), link("mount", ""), link("base"), mount, floating)), HERE
    ).model
    assert model.joint("root").type == mujoco.mjtJoint.mjJNT_FREE
    assert model.body("base").pos.tolist() == [0.0, 0.0, 1.5]


def test_the_base_floats_where_the_scene_says_so(urdf: Urdf) -> None:
    path = str(urdf(ARM))
    model = load_scene(Source(path, base="floating"), HERE).model
    assert model.joint(FLOATING_BASE).type == mujoco.mjtJoint.mjJNT_FREE
    free = (
        "<mujoco><worldbody><body name='b'><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    assert load_scene(Source(free, base="fixed"), HERE).model.nv == 0


@pytest.mark.parametrize(
    ("uri", "place"),
    [
        ("package://arm_description/meshes/l1.stl", "arm_description/meshes/l1.stl"),
        ("package://renamed/meshes/l1.stl", "arm_description/meshes/l1.stl"),
        ("../meshes/l1.stl", "arm_description/meshes/l1.stl"),
    ],
)
def test_meshes_are_found_from_the_file_and_converted(
    urdf: Urdf, tmp_path: Path, uri: str, place: str
) -> None:
    pytest.importorskip("trimesh")
    (tmp_path / place).parent.mkdir(parents=True)
    (tmp_path / place).write_text(TETRAHEDRON)
    path = urdf(with_mesh(uri), name="arm_description/urdf/robot.urdf")
    scene = load_scene(str(path), HERE)
    assert scene.left_out == {}
    assert scene.model.nmesh == 1
    assert scene.model.ngeom == 2


@pytest.mark.parametrize("given", ["packages", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_packages_are_looked_for(
    urdf: Urdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    pytest.importorskip("trimesh")
    folder = tmp_path / "elsewhere" / "share" / "arm"
    folder.mkdir(parents=True)
    (folder / "l1.stl").write_text(TETRAHEDRON)
    packages: tuple[tuple[str, str], ...] = ()
    if given == "packages":
        packages = (("arm", str(folder)),)
    elif given == "ROS_PACKAGE_PATH":
        monkeypatch.setenv(given, str(folder.parent))
    else:
        monkeypatch.setenv(given, str(folder.parents[1]))
    path = urdf(with_mesh("package://arm/l1.stl"), name="here/robot.urdf")
    assert load_scene(Source(str(path), packages=packages), HERE).left_out == {}


def test_missing_meshes_are_one_notice(urdf: Urdf) -> None:
    scene = load_scene(str(urdf(with_mesh("package://nowhere/l1.dae"))), HERE)
    assert scene.left_out == {"l1.dae": "missing"}
    assert len(scene.notices) == 1
    assert "no collision" in scene.notices[0]
    assert load_scene(Source(str(urdf(with_mesh("x.stl"))), meshes="off"), HERE).model.nmesh == 0


@pytest.mark.parametrize(
    "inside",
    [
        "",
        INERTIAL.replace('"1"', '"0"').replace('".01"', '"0"'),
        INERTIAL.replace('izz=".01"', 'izz="9"'),
        INERTIAL.replace('ixy="0"', 'ixy="2"'),
    ],
)
def test_inertias_that_only_physics_needs_are_repaired(urdf: Urdf, inside: str) -> None:
    scene = load_scene(str(urdf(ARM.replace(link("l2"), link("l2", inside)))), HERE)
    assert any("l2" in notice and "repaired" in notice for notice in scene.notices)
    assert (scene.model.body("l2").inertia > 0.0).all()


def test_a_declaration_of_no_version_of_xml_is_no_matter(urdf: Urdf) -> None:
    path = urdf(ARM)
    path.write_text(f'<?xml version="0.0" ?><!-- <mujoco> -->{path.read_text()}')
    assert load_scene(str(path), HERE).velocity == {"j1": 0.5, "j2": 0.5}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (ARM.replace("0.5 0 0", "0.5 zero 0"), r"robot.urdf:1: joint 'j2': xyz=.*3 numbers"),
        (ARM + link("l1"), "link 'l1' is here twice: see line 1"),
        ("", "has no <link>"),
        (ARM.replace('child link="tool0"', 'child link="tol0"'), "no link named 'tol0'.*'tool0'"),
        (ARM.replace("revolute", "revolut", 1), "no type named 'revolut'.*'revolute'"),
        (ARM + "<link", "not XML"),
    ],
)
def test_mistakes_have_file_line_and_name(urdf: Urdf, wrong: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_scene(str(urdf(wrong)), HERE)


def test_a_xacro_takes_arguments(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    path = tmp_path / "arm.urdf.xacro"
    parts = ARM.replace('name="', 'name="${p}').replace('link="', 'link="${p}')
    path.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:arg name="prefix" default=""/><xacro:property name="p" value="$(arg prefix)"/>'
        f"{parts}</robot>"
    )
    source = Source(str(path), arguments=(("prefix", "left_"),))
    assert load_scene(source, HERE).velocity == {"left_j1": 0.5, "left_j2": 0.5}
    with pytest.raises(ModelError, match="no xacro"):
        load_scene(Source("<mujoco/>", arguments=(("a", "b"),)), HERE)


HAND = """<mujoco><worldbody><body name="palm"><freejoint/><geom size=".01"/>
<body name="finger"><joint name="grip" range="0 1"/><geom size=".01"/></body></body></worldbody>
<actuator><position name="close" joint="grip"/></actuator>
<keyframe><key name="home" qpos="0 0 0 1 0 0 0 0.7" ctrl="0.6"/></keyframe></mujoco>"""
BODY = """<mujoco><worldbody><body name="upper"><joint name="hip"/><geom size=".01"/>
<body name="lower" pos="1 0 0"><joint name="knee"/><geom size=".01"/>
<site name="mount" pos="1 0 0"/></body></body>
<body name="other"><joint name="last"/><geom size=".01"/></body></worldbody>
<actuator><motor name="turn" joint="last"/></actuator>
<keyframe><key name="away" qpos="0.1 0.2 0.3" ctrl="5"/><key name="zero"/></keyframe></mujoco>"""


def test_what_is_attached_stands_at_its_home_and_keyframes_stay_valid() -> None:
    parts = tuple(Attachment(Source(HAND), "site", "mount", f"{n}_") for n in ("a", "b"))
    scene = load_scene(Source(BODY, attach=parts[:1]), HERE)
    model, key = scene.model, scene.model.key("away")
    assert model.body("a_palm").parentid == model.body("lower").id
    values = {model.joint(j).name: key.qpos[model.jnt_qposadr[j]] for j in range(model.njnt)}
    assert values == {"hip": 0.1, "knee": 0.2, "a_grip": 0.7, "last": 0.3}
    controls = {model.actuator(i).name: key.ctrl[i] for i in range(model.nu)}
    assert controls == {"turn": 5.0, "a_close": 0.6}
    assert model.key("zero").qpos[model.joint("a_grip").qposadr] == 0.7
    assert scene.rest[model.joint("a_grip").qposadr] == 0.7
    assert load_scene(Source(BODY, attach=parts), HERE).model.nq == 5
    with pytest.raises(ModelError, match="no site 'moutn'"):
        load_scene(Source(BODY, attach=(Attachment(Source(HAND), "site", "moutn"),)), HERE)


def test_what_has_no_name_gets_one() -> None:
    text = "<mujoco><worldbody><body><joint/><geom size='1'/><body><joint/><joint axis='1 0 0'/>"
    model = load_scene(text + "<geom size='1'/></body></body></worldbody></mujoco>", HERE).model
    assert [model.body(i).name for i in (1, 2)] == ["body1", "body2"]
    named = [model.joint(i).name for i in range(3)]
    assert named == ["body1_joint", "body2_joint", "body2_joint2"]


@pytest.mark.parametrize("kind", ["text", "spec", "model"])
def test_a_scene_built_in_python_runs(kind: str) -> None:
    built = {
        "text": BODY,
        "spec": mujoco.MjSpec.from_string(BODY),
        "model": mujoco.MjModel.from_xml_string(BODY),
    }[kind]
    config = made(
        scene=built,
        tasks=[{"name": "hand", "type": "frame", "frame": {"site": "mount"}, "B": 1.0}],
        start="away",
        duration=0.02,
    )
    run = rmrc.solve(config)
    np.testing.assert_array_equal(run.q[0], [0.1, 0.2, 0.3])


def test_a_wrong_name_suggests_every_type_of_file(tmp_path: Path, urdf: Urdf) -> None:
    urdf(ARM)
    (tmp_path / "scene.xml").write_text(BODY)
    with pytest.raises(
        ModelError, match=r"did you mean 'robot.urdf'\? There is: robot.urdf, scene"
    ):
        load_scene("robot.xml", tmp_path)
    assert load_scene(str(tmp_path), HERE).model.nv == 3  # the scene.xml of a folder


def test_of_what_is_there_twice_the_first_counts(urdf: Urdf) -> None:
    twice = ARM.replace("<axis", '<axis xyz="0 0 1"/><axis', 1)
    scene = load_scene(str(urdf(twice)), HERE)
    np.testing.assert_allclose(scene.model.joint("j1").axis, [0, 0, 1])
    assert any("joint 'j1' has a second <axis>" in notice for notice in scene.notices)


def test_a_scene_is_read_again_when_what_it_includes_changes(tmp_path: Path) -> None:
    inner, outer = tmp_path / "arm.xml", tmp_path / "scene.xml"
    arm = '<mujoco><worldbody><body><joint name="{}"/><geom size=".1"/></body></worldbody></mujoco>'
    inner.write_text(arm.format("hip"))
    outer.write_text('<mujoco><include file="arm.xml"/></mujoco>')
    assert load_scene(str(outer), HERE).model.joint(0).name == "hip"
    inner.write_text(arm.format("knee"))
    assert load_scene(str(outer), HERE).model.joint(0).name == "knee"


def test_a_mesh_of_no_valid_scale_is_left_out_and_said(urdf: Urdf) -> None:
    wrong = with_mesh("part.stl").replace("<mesh ", '<mesh scale="1 1 1 1" ')
    scene = load_scene(str(urdf(wrong)), HERE)
    assert scene.model.nmesh == 0
    assert any("is to be 3 numbers: the mesh is left out" in notice for notice in scene.notices)


@pytest.mark.parametrize("ending", [".dae", ".glb"])
def test_meshes_of_other_kinds_are_converted(urdf: Urdf, tmp_path: Path, ending: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    if ending == ".dae":
        pytest.importorskip("collada")
    path = urdf(with_mesh(f"part{ending}"))
    trimesh.creation.box((0.1, 0.2, 0.3)).export(path.parent / f"part{ending}")
    scene = load_scene(str(path), HERE)
    assert scene.left_out == {}
    box = np.ptp(scene.model.mesh_vert, axis=0)
    np.testing.assert_allclose(np.sort(box), [0.1, 0.2, 0.3], atol=1e-6)


def test_robots_of_robot_descriptions_are_found(
    urdf: Urdf, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("robot_descriptions")
    found = ModuleType("robot_descriptions.ur5e_description")
    found.__dict__["URDF_PATH"] = str(urdf(ARM))  # that of the package fetches a repository
    monkeypatch.setitem(sys.modules, found.__name__, found)
    monkeypatch.setitem(sys.modules, "robot_descriptions.ur5e_mj_description", None)
    scene = load_scene("robot_descriptions:ur5e_description", HERE)
    assert scene.velocity == {"j1": 0.5, "j2": 0.5}
    with pytest.raises(ModelError, match=r"ur5f' does not exist.*'ur5e'"):
        load_scene("robot_descriptions:ur5f", HERE)
