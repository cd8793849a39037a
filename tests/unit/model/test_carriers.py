"""Moving mocap bodies: what they carry is fed forward in every task, and starts at the keyframe."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import config, random_configuration
from rmrc.problem.evaluation import Evaluation
from rmrc.runs.check import check

Array = NDArray[np.float64]

STEP = 1e-6
# Central differences err by STEP²·f''' ≈ 1e-12 and by rounding/STEP ≈ 1e-10 · the size of e.
CENTRAL_DIFFERENCE = 1e-8
# The solver of distances ends within 1e-6 of the least distance, which a longer step divides.
MEASURED_STEP, MEASURED_DIFFERENCE = 1e-3, 5e-3
# v of the two engines, relative to its largest element, as docs/native.md promises.
ENGINES = 1e-8
LAG = 1e-4
"""m, at 0.2 m/s."""

LINKS = (("0 0 1", "0 0 0.2"), ("0 1 0", "0.25 0 0"), ("0 1 0", "0.25 0 0"), ("1 0 0", "0.1 0 0"),
         ("0 1 0", "0.1 0 0"), ("1 0 0", "0.05 0 0"))  # fmt: skip


def arm() -> str:
    """Return an arm with six hinges, bent at its zero."""
    text, bend = "", (0.0, -0.6, 1.2, 0.3, 0.5, 0.0)
    for k, ((axis, offset), angle) in enumerate(zip(LINKS, bend, strict=True)):
        along = np.array(axis.split(), dtype=float) * np.sin(angle / 2)
        quaternion = " ".join(map(str, (np.cos(angle / 2), *along)))
        text += f'<body name="link{k}" pos="{offset}" quat="{quaternion}">'
        text += f'<joint name="j{k}" axis="{axis}"/><geom type="capsule" fromto="0 0 0 .05 0 0" '
        text += 'size=".02"/>'
    text += '<geom name="fist" type="sphere" size=".04" pos=".1 0 0"/>'
    text += '<site name="tip" pos=".12 .01 0" euler=".1 .2 .3"/>'
    return text + "</body>" * len(LINKS)


SCENE = f"""
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="cart" mocap="true" pos="0.5 0.25 0.2" quat="0.9 0.1 0.3 0.2">
      <geom name="tray" type="sphere" size="0.05"/>
      <site name="handle" pos="0.1 0.05 0.1" euler=".2 .3 .4"/>
      <body name="rider" pos="0 0.1 0.3" euler="0.3 0.1 0">
        <joint name="lean" axis="0 1 0"/><joint name="lift" type="slide" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0 .1 .2" size=".03"/>
        <site name="mast" pos="0 .1 .25" euler=".3 .1 0"/>
      </body>
    </body>
    {arm()}
  </worldbody>
  <equality>
    <connect name="pin" body1="cart" body2="link5" anchor=".1 0 0"/>
    <weld name="grip" body1="link5" body2="cart" anchor=".03 .02 .01" torquescale="0.7"
          relpose=".1 .2 .1 .9 .1 .2 .3"/>
    <weld name="held" site1="handle" site2="tip" torquescale="2"/>
    <weld name="inside" body1="rider" body2="link5"/>
    <connect name="fixed" body1="cart" body2="world" anchor=".1 0 0"/>
  </equality>
</mujoco>
"""
TIP, MAST, HANDLE = {"site": "tip"}, {"site": "mast"}, {"site": "handle"}
FAR = {"position": 50.0}
TASKS: list[dict[str, Any]] = [
    {"name": "frame", "type": "frame", "frame": MAST, "clamp": FAR},
    {"name": "world", "type": "frame", "frame": MAST, "axes": "world", "clamp": FAR},
    {"name": "on_root", "type": "relative_frame", "frame": TIP, "root": HANDLE},
    {"name": "on_frame", "type": "relative_frame", "frame": MAST, "root": TIP},
    {"name": "on_both", "type": "relative_frame", "frame": MAST, "root": HANDLE},
    {"name": "look", "type": "look_at", "frame": MAST, "axis": [0.2, -0.3, 1.0]},
    {"name": "align", "type": "axis_align", "frame": MAST, "axis": [1.0, 0.5, 0.0]},
    {"name": "com", "type": "com"},
    *(
        {"name": name, "type": "loop", "hard": False, "equalities": [name]}
        for name in ("pin", "grip", "held", "inside", "fixed")
    ),
    {"name": "posture", "type": "posture", "level": 1},
]
UNMOVED = ("on_both", "fixed", "posture")
"""Tasks whose error no mocap body changes; MuJoCo leaves out a constraint that no joint moves."""
CLEARANCE = {"name": "clear", "type": "clearance", "pairs": [["fist", "cart"], ["rider", "fist"]],
             "distance": 2.0}  # fmt: skip


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "cart.xml"
    path.write_text(SCENE)
    return str(path)


def scattered(evaluation: Evaluation, rng: np.random.Generator, q: Array) -> None:
    """Give the mocap body a pose and a velocity, and the targets some distance."""
    data = evaluation.data
    data.mocap_pos += rng.normal(size=3) * 0.1
    data.mocap_quat += rng.normal(size=4) * 0.3
    data.mocap_quat /= np.linalg.norm(data.mocap_quat)
    for term in evaluation.terms:
        target = evaluation.target[term.name]
        if term.target_kind == "pose":
            target[4:] += rng.normal(size=3) * 0.3
            target[:4] += rng.normal(size=4) * 0.3
            target[:4] /= np.linalg.norm(target[:4])
        elif term.target_kind == "point":
            target += rng.normal(size=3)
    evaluation.update(q)


def by_mocap(evaluation: Evaluation, q: Array, twist: Array, step: float) -> Array:
    """Return ∂e/∂t by central differences over the motion of the mocap body."""
    data, ends = evaluation.data, []
    place, turned = data.mocap_pos.copy(), data.mocap_quat.copy()
    axis, speed = twist[3:] / np.linalg.norm(twist[3:]), float(np.linalg.norm(twist[3:]))
    for sign in (1.0, -1.0):
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, axis, sign * step * speed)
        mujoco.mju_mulQuat(data.mocap_quat[0], turn, turned[0])
        data.mocap_pos[0] = place[0] + sign * step * twist[:3]
        evaluation.update(q)
        evaluation.evaluate()
        ends.append(evaluation.error.copy())
    data.mocap_pos[:], data.mocap_quat[:] = place, turned
    return (ends[0] - ends[1]) / (2.0 * step)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("moving", [False, True])
def test_feed_forward_is_the_errors_derivative_by_the_mocap_motion(
    scene: str, seed: int, moving: bool
) -> None:
    evaluation = Evaluation(rmrc.compile(config(scene, TASKS)))
    rng = np.random.default_rng(seed)
    q = random_configuration(evaluation.model, evaluation.problem.start, rng, 0.5)
    scattered(evaluation, rng, q)
    own = np.zeros_like(evaluation.feedforward)
    if moving:  # targets with velocities of their own add theirs
        for name in ("frame", "world", "on_root", "look", "com"):
            evaluation.twist[name][:] = rng.normal(size=6)
            evaluation.moving[evaluation.index[name]] = 1
        evaluation.evaluate()
        own = evaluation.feedforward.copy()
    twist = rng.normal(size=6)
    evaluation.obstacle_twist[0] = twist
    evaluation.update(q)
    evaluation.evaluate()
    analytic = evaluation.feedforward - own
    numeric = by_mocap(evaluation, q, twist, STEP)
    for term in evaluation.terms:
        rows = evaluation.rows_of([term])
        assert np.abs(analytic[rows] - numeric[rows]).max() < CENTRAL_DIFFERENCE, term.name
        assert (np.abs(analytic[rows]).max() > 0.01) == (term.name not in UNMOVED), term.name
    evaluation.obstacle_twist[0] = 0.0
    evaluation.update(q)
    evaluation.evaluate()
    np.testing.assert_array_equal(evaluation.feedforward, own)


def test_clearance_feeds_forward_how_mocap_bodies_come_near(scene: str) -> None:
    evaluation = Evaluation(rmrc.compile(config(scene, [CLEARANCE], equalities="off")))
    rng, twist = np.random.default_rng(0), np.array([0.3, -0.2, 0.1, 0.5, 0.4, -0.6])
    q = random_configuration(evaluation.model, evaluation.problem.start, rng, 0.3)
    numeric = by_mocap(evaluation, q, twist, MEASURED_STEP)
    evaluation.obstacle_twist[0] = twist
    evaluation.update(q)
    evaluation.evaluate()
    assert np.abs(numeric).min() > 0.01
    assert np.abs(evaluation.feedforward - numeric).max() < MEASURED_DIFFERENCE


@pytest.mark.parametrize("tasks", [TASKS, [*TASKS, CLEARANCE]], ids=["own", "foreign"])
def test_engines_agree_on_what_mocap_bodies_carry(scene: str, tasks: list[dict[str, Any]]) -> None:
    problem = rmrc.compile(config(scene, tasks, dt=0.005, equalities="off"))
    leader, twin = (rmrc.Controller(problem, engine=engine) for engine in ("python", "native"))
    rng = np.random.default_rng(0)
    twist = np.zeros(6)
    q, place, turn = (
        problem.start.copy(),
        np.array([0.5, 0.25, 0.2]),
        np.array([0.9, 0.1, 0.3, 0.2]),
    )
    for k in range(100):
        if k % 20 == 0:
            twist = rng.normal(size=6) * (0.0 if k == 60 else 0.3)
        if k % 30 == 0:
            aim = rng.normal(size=6) * 0.1 if k else None
            for controller in (leader, twin):
                controller.set_target("frame", velocity=aim)
        place = place + twist[:3] * 0.005
        mujoco.mju_quatIntegrate(turn, twist[3:], 0.005)
        for controller in (leader, twin):
            assert controller.set_obstacle("cart", place, turn, twist)
        python, native = leader.step(q), twin.step(q)
        fed = (each.engine.evaluation.feedforward for each in (leader, twin))
        np.testing.assert_allclose(*fed, rtol=0.0, atol=ENGINES)
        scale = max(1.0, float(np.abs(python.v).max()))
        assert np.abs(python.v - native.v).max() < ENGINES * scale
        q = python.q


@pytest.mark.parametrize("engine", ["python", "native"])
@pytest.mark.parametrize("gain", [2.0, 10.0, "deadbeat"])
def test_frame_follows_a_moving_mocap_site_without_lag(
    scene: str, engine: Any, gain: float | str
) -> None:
    tasks = [{"name": "follow", "type": "relative_frame", "frame": TIP, "root": HANDLE,
              "gain": gain}]  # fmt: skip
    problem = rmrc.compile(
        config(scene, tasks, dt=0.002, damping={"lambda": 0.003}, equalities="off")
    )
    controller, model = rmrc.Controller(problem, engine=engine), problem.model
    data, place, speed = mujoco.MjData(model), model.body("cart").pos.copy(), [0.0, -0.2, 0.0]
    data.qpos[:] = problem.start
    mujoco.mj_kinematics(model, data)
    tip, handle = data.site("tip"), data.site("handle")
    apart = tip.xpos - handle.xpos
    for _ in range(500):
        assert controller.set_obstacle("cart", place, velocity=[*speed, 0.0, 0.0, 0.0])
        step = controller.step()
        place += np.array(speed) * problem.dt
        data.qpos[:], data.mocap_pos[0] = step.q, place
        mujoco.mj_kinematics(model, data)
        assert np.linalg.norm(tip.xpos - handle.xpos - apart) < LAG
        assert step.status is rmrc.Status.OK


@pytest.mark.parametrize("follow", ["rate", "waypoints"])
def test_frame_follows_a_mocap_body_on_its_path(scene: str, follow: str) -> None:
    tasks = [{"name": "follow", "type": "relative_frame", "frame": TIP, "root": HANDLE}]
    path = {"path": "line", "to": {"position": [0.5, 0.05, 0.2]}, "speed": 0.2,
            "profile": "constant"}  # fmt: skip
    made = config(
        scene,
        tasks,
        dt=0.002,
        duration=1.0,
        obstacles={"cart": path},
        follow=follow,
        equalities="off",
    )
    run = rmrc.solve(made)
    assert run.error["follow"][:, 0].max() < LAG
    assert run.mocap is not None
    assert np.ptp(run.mocap.reshape(-1, 7)[:, 1]) > 0.19


KEYED = """
<mujoco>
  <worldbody>
    <body name="car"><joint name="x" type="slide" axis="1 0 0" range="-3 3"/>
      <geom name="ball" type="sphere" size=".05"/><site name="tip"/></body>
    <body name="gate" mocap="true" pos="7 1 0"/>
    <body name="obstacle" mocap="true" pos="5 0 0">
      <geom name="wall" type="sphere" size=".18"/><site name="mark" pos="0 0 .2"/></body>
  </worldbody>
  <keyframe>
    <key name="home" qpos="0" mpos="7 2 0 0.6 0 0" mquat="1 0 0 0 2 0 0 2"/>
    <key name="away" qpos="0.1" mpos="7 3 0 -0.6 0 0"/>
  </keyframe>
</mujoco>
"""
CAR = [{"name": "tip", "type": "frame", "frame": TIP, "B": {"position": 1.0, "orientation": 0.0}}]
APART = {"collision": {"pairs": [["ball", "wall"]], "d_min": 0.02, "detect": 0.2}}


@pytest.fixture
def keyed(tmp_path: Path) -> str:
    path = tmp_path / "keyed.xml"
    path.write_text(KEYED)
    return str(path)


@pytest.mark.parametrize(("start", "stop"), [("home", 0.35), (None, 0.35), ({"x": 0.0}, 0.35),
                                             ([0.0], 0.35), ("away", 1.0)])  # fmt: skip
@pytest.mark.parametrize("engine", ["python", "native"])
def test_mocap_bodies_start_where_the_keyframe_has_them(
    keyed: str, start: Any, stop: float, engine: str
) -> None:
    made = config(keyed, CAR, start=start, dt=0.01, duration=2.0, limits=APART, engine=engine,
                  targets={"tip": {"path": "pose", "position": [1.0, 0, 0]}})  # fmt: skip
    run = rmrc.solve(made)
    assert abs(run.q[-1, 0] - stop) < 1e-3
    assert run.summary["limits"]["collision"]["max_violation"] == 0.0


def test_targets_paths_check_and_reset_begin_at_the_keyframe(keyed: str) -> None:
    tasks = [*CAR, {"name": "near", "type": "relative_frame", "frame": TIP,
                    "root": {"site": "mark"}}]  # fmt: skip
    moved = {"obstacle": {"path": "line", "coordinates": "start", "to": {"position": [0.1, 0, 0]},
                          "duration": 1.0}}  # fmt: skip
    near = {"collision": APART["collision"] | {"d_min": 0.4, "detect": 0.5}}
    made = config(keyed, tasks, duration=1.2, obstacles=moved, limits=near)
    problem = rmrc.compile(made)
    # Half a turn about z and a half: the mark sees the car at −0.6 along its own −y.
    np.testing.assert_allclose(problem.named("near").target[4:], [0.0, 0.6, -0.2], atol=1e-9)
    assert any("beyond the collision limit" in line for line in check(made))
    controller = rmrc.Controller(problem)
    data = controller.engine.evaluation.data
    assert controller.set_obstacle("obstacle", position=[2.0, 0.0, 0.0])
    controller.reset()
    np.testing.assert_array_equal(data.mocap_pos, [[7, 2, 0], [0.6, 0, 0]])
    np.testing.assert_allclose(np.linalg.norm(data.mocap_quat, axis=1), 1.0)
    run = rmrc.solve(made)
    assert run.mocap is not None
    end = run.mocap[-1].reshape(-1, 7)  # along the obstacle's own x, the world's y
    np.testing.assert_allclose(end[1, :3], [0.6, 0.1, 0.0], atol=1e-9)
