"""What a robot's file says holds while it moves, judged by MuJoCo alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from descriptions import ARM, FINGERS, joint, link
from models import config as made
from rmrc.errors import ConfigError
from rmrc.limits.models import LimitsModel, PerJoint
from rmrc.runs.check import check

Urdf = Callable[..., Path]

HELD = 1e-6
"""m or rad that equalities may be off, and shares that rates of rounded q may be above a speed."""
SAME = 1e-8
"""What the two engines agree to."""

TENDONS = """<mujoco><worldbody><site name="post" pos="0 0.5 0"/>
<body name="a"><joint name="j1" axis="0 0 1"/><geom size=".05"/>
<body name="b" pos=".5 0 0"><joint name="j2" axis="0 0 1"/><geom size=".05"/>
<site name="tip" pos=".5 0 0"/></body></body></worldbody><tendon>{}</tendon></mujoco>"""
SUM = (
    '<fixed name="t" limited="true" range="-.5 .5">'
    '<joint joint="j2" coef="1"/><joint joint="j1" coef="1"/></fixed>'
)
ROPE = (
    '<spatial name="t" limited="true" range="0.6 1.3">'
    '<site site="post"/><site site="tip"/></spatial>'
)

CART = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="y" type="slide" axis="0 1 0"/><joint name="yaw" axis="0 0 1"/><geom size=".1"/>
<site name="front" pos=".3 0 0"/></body></worldbody></mujoco>"""


def position_task(frame: Any, name: str = "hand", **others: Any) -> dict[str, Any]:
    weight = {"position": 1.0, "orientation": 0.0}
    return {"name": name, "type": "frame", "frame": frame, "B": weight, **others}


def to(position: list[float]) -> dict[str, Any]:
    return {"hand": {"path": "pose", "position": position}}


def at(model: mujoco.MjModel, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("engine", ["python", "native"])
def test_fingers_mimic_and_the_files_speeds_hold(urdf: Urdf, engine: str) -> None:
    config = made(
        scene=str(urdf(ARM, FINGERS)),
        engine=engine,
        tasks=[position_task("left"), {"name": "rest", "type": "posture", "level": 1, "B": 0.01}],
        targets=to([0.3, 0.95, 0.0]),
        dt=0.005,
        duration=4.0,
        limits={"velocity": {"default": 2.0}},
    )
    run = rmrc.solve(config)
    rates = np.abs(np.diff(run.q, axis=0)) / config.dt
    assert (rates.max(axis=0) <= np.array([0.5, 0.5, 0.1, 0.1]) * (1.0 + HELD)).all()
    assert rates[:, 0].max() > 0.4  # and the limit is used
    assert np.abs(run.q[:, 2] - run.q[:, 3]).max() <= HELD
    named = config.model_copy(
        update={"limits": LimitsModel(velocity=PerJoint.model_validate({"j1": 1.5}))}
    )
    assert rmrc.compile(named).box.velocity.tolist() == [1.5, 0.5, 0.1, 0.1]


def test_equalities_off_leaves_them_open_and_says_so(urdf: Urdf) -> None:
    config = made(
        scene=str(urdf(ARM, FINGERS)),
        equalities="off",
        tasks=[{"name": "v", "type": "velocity", "target": {"f1": 0.05}}],
        duration=0.2,
    )
    run = rmrc.solve(config)
    assert run.q[-1, 2] > 0.005
    assert run.q[-1, 3] == 0.0
    assert any("not held: 'f2 mimics f1'" in line for line in check(config))


@pytest.mark.parametrize("robot", ["agility_cassie/cassie", "robotiq_2f85/2f85", "aloha/aloha"])
def test_robots_with_equalities_keep_them(menagerie: Path, robot: str) -> None:
    scene = str(menagerie / f"{robot}.xml")
    tasks = [{"name": "rest", "type": "posture", "gain": 2.0, "target": None}]
    config = made(scene=scene, tasks=tasks, duration=1.0, dt=0.005)
    problem = rmrc.compile(config)
    rng, controller = np.random.default_rng(0), rmrc.Controller(problem)
    goal = problem.start.copy()
    mujoco.mj_integratePos(problem.model, goal, rng.uniform(-0.1, 0.1, problem.model.nv), 1.0)
    controller.set_target("rest", q=goal)
    q = problem.start
    for _ in range(400):
        q = controller.step(q).q
    data = at(problem.model, q)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert rows.any()
    assert np.abs(q - problem.start).max() > 0.01
    assert np.abs(data.efc_pos[rows]).max() <= HELD


@pytest.mark.parametrize(("tendon", "ends"), [(SUM, (-0.5, 0.5)), (ROPE, (0.6, 1.3))])
def test_tendons_stay_in_their_ranges(tendon: str, ends: tuple[float, float]) -> None:
    ways = []
    for engine in ("python", "auto"):
        config = made(
            scene=TENDONS.format(tendon),
            engine=engine,
            tasks=[position_task({"site": "tip"})],
            targets=to([0.1, 0.65, 0.0]),
            dt=0.01,
            duration=1.0,
        )
        run = rmrc.solve(config)
        model = rmrc.compile(config).model
        lengths = np.array([at(model, q).ten_length[0] for q in run.q[::10]])
        assert ends[0] - HELD <= lengths.min()
        assert lengths.max() <= ends[1] + HELD
        assert min(lengths.max() - ends[1], ends[0] - lengths.min(), key=abs) > -1e-3  # it binds
        ways.append(run.q)
    np.testing.assert_allclose(ways[0], ways[1], atol=SAME)


def test_a_tendon_in_space_is_the_python_engines() -> None:
    config = made(scene=TENDONS.format(ROPE), tasks=[position_task({"site": "tip"})])
    assert any("tendon with a path in space" in line for line in check(config))


def test_wheels_do_not_slide_sideways() -> None:
    ways = []
    for engine in ("python", "native"):
        rolling = {"name": "wheels", "type": "coupling", "frame": {"body": "cart"}}
        config = made(
            scene=CART,
            engine=engine,
            tasks=[position_task("front"), {**rolling, "rates": {"linear": [0, 1, 0]}}],
            targets=to([0.8, 1.0, 0.0]),
            dt=0.01,
            duration=2.5,
        )
        run = rmrc.solve(config)
        assert run.summary["converged"]
        yaw, rate = run.q[:-1, 2], np.diff(run.q, axis=0) / config.dt
        sideways = -np.sin(yaw) * rate[:, 0] + np.cos(yaw) * rate[:, 1]
        assert np.abs(sideways).max() <= HELD
        ways.append(run.q)
    np.testing.assert_allclose(ways[0], ways[1], atol=SAME)


@pytest.mark.parametrize("kind", ["site", "body", "geom"])
@pytest.mark.parametrize("engine", ["python", "native"])
def test_a_frame_may_be_displaced(kind: str, engine: str) -> None:
    turned = [0.5, 0.5, -0.5, 0.5]
    part = (
        "<site name='part' pos='.1 .2 .3' quat='0 1 0 0'/>"
        "<geom name='part' size='.1' pos='.3 0 .1' quat='.6 0 .8 0'/>"
    )
    text = (
        "<mujoco><worldbody><body name='base'><joint axis='0 0 1'/><geom size='.1'/>"
        "<body name='part' pos='.4 0 0'><joint axis='0 1 0'/><joint axis='1 0 0'/>"
        f"{part}</body></body></worldbody></mujoco>"
    )
    offset = {"position": [0.1, -0.2, 0.3], "quaternion": turned}
    config = made(
        scene=text,
        engine=engine,
        tasks=[{"name": "hand", "type": "frame", "frame": {kind: "part", "offset": offset}}],
    )
    problem = rmrc.compile(config)
    q = np.array([0.4, -0.3, 0.8])
    data = at(problem.model, q)
    seen = getattr(data, kind)("part")
    origin, rotation = (seen.xpos, seen.xmat.reshape(3, 3))
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.array(turned))
    pose = problem.forward(q)["hand"]
    np.testing.assert_allclose(pose[:3, 3], origin + rotation @ offset["position"], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], rotation @ turn.reshape(3, 3), atol=1e-12)


def test_short_names_are_of_one_thing_alone(urdf: Urdf) -> None:
    scene = str(urdf(ARM))
    assert rmrc.compile(made(scene=scene, tasks=[position_task("tool0")])).terms
    for frame, message in (
        ("tool1", "no site, body or geom named 'tool1'; did you mean 'tool0'"),
        ("base_link", "no joint moves this"),
    ):
        with pytest.raises(ConfigError, match=message):
            rmrc.compile(made(scene=scene, tasks=[position_task(frame)]))
    both = "<body name='a'><joint/><geom name='a' size='1'/></body>"
    text = f"<mujoco><worldbody>{both}</worldbody></mujoco>"
    with pytest.raises(ConfigError, match=r"{body: a} or {geom: a}"):
        rmrc.compile(made(scene=text, tasks=[position_task("a")]))


def test_a_subtree_is_all_that_hangs_on_a_body(repository: Path) -> None:
    def pairs(side: Any) -> set[tuple[int, int]]:
        config = made(
            scene=str(repository / "scenes" / "dual_arm.xml"),
            tasks=[{"name": "rest", "type": "posture"}],
            limits={"collision": {"pairs": [[side, "table"]], "groups": {"left": [side]}}},
        )
        return {tuple(pair) for pair in rmrc.compile(config).barriers[0].geoms.tolist()}  # pyright: ignore

    whole, hand = pairs({"subtree": "left_link1"}), pairs({"subtree": "left_link5"})
    assert hand < whole


def test_the_start_is_home_or_the_only_keyframe_or_inside_the_ranges(urdf: Urdf) -> None:
    scene = (
        "<mujoco><worldbody><body><joint name='a' range='1 2'/><geom size='1'/>"
        "<body><joint name='b' range='-9 9'/><geom size='1'/></body></body></worldbody>"
        "<compiler angle='radian'/>"
        "<equality><joint joint1='b' joint2='a' polycoef='0 2 0 0 0'/></equality>"
        "<keyframe>{}</keyframe></mujoco>"
    )
    one, home = "<key qpos='1.5 3'/>", "<key name='home' qpos='1.2 2.4'/>"
    for keys, start, said in (
        ("", [1.0, 2.0], "qpos0, moved inside the ranges: a, b"),
        (one, [1.5, 3.0], "the start is the keyframe"),
        (one + home, [1.2, 2.4], "the keyframe 'home'"),
        (one + one.replace("key", "key name='x'"), [1.0, 2.0], "qpos0"),
    ):
        config = made(scene=scene.format(keys), tasks=[{"name": "r", "type": "posture"}])
        assert rmrc.compile(config).start.tolist() == start
        assert any(said in line for line in check(config))


def test_objects_of_a_urdf_scene_stay(urdf: Urdf) -> None:
    floating = link("cup") + joint("free", "floating", "base_link", "cup", at="1 1 0")
    config = made(scene=str(urdf(ARM, floating)), tasks=[position_task("tool0")], duration=0.2)
    assert rmrc.compile(config).objects.roots
