"""The barriers of ball joints and of the workspace: slopes, bounds, and what a run keeps."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import rmrc
from models import CHAIN, PLANES, REPOSITORY, config, random_configuration
from rmrc.errors import ConfigError
from rmrc.limits.ball import compile_balls
from rmrc.limits.barrier import Barrier
from rmrc.limits.models import LimitsModel
from rmrc.limits.workspace import compile_workspace

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
POSTURE = {"name": "posture", "type": "posture"}

# Central differences with a step of 1e-6 of functions with second derivatives of the order of 1.
STEP, DIFFERENCE = 1e-6, 1e-7
# A distance is a sum of a dozen products of numbers of the order of 1.
ROUNDING = 1e-12
# The step's own tolerance on distances at the configuration that it leads to.
KEPT = 1e-6
# With acceleration limits, joints that brake cannot follow a plane exactly; such a step says so.
RELAXED = 1e-4
# The hand goes up to its planes, though the task's error is not the distance from them.
NEAR = 0.03


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(CHAIN)


def barrier_of(kind: str, model: mujoco.MjModel, twist: np.ndarray) -> Barrier:
    limits = LimitsModel.model_validate({"workspace": PLANES, "position": {"margin": 0.1}})
    every = np.arange(model.nv)
    if kind == "position":
        (spec,) = compile_balls(model, limits, every)
    else:
        (spec,) = compile_workspace(model, limits.workspace, every, [])
    return spec.build(model, twist)


def at(model: mujoco.MjModel, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def moved(model: mujoco.MjModel, q: np.ndarray, step: np.ndarray) -> mujoco.MjData:
    q = q.copy()
    mujoco.mj_integratePos(model, q, step, 1.0)
    return at(model, q)


def spun(model: mujoco.MjModel, q: np.ndarray, twist: np.ndarray, time: float) -> mujoco.MjData:
    """Return the data after the mocap body has moved for a while."""
    data = at(model, q)
    turn, turned = np.empty(4), np.empty(4)
    angle = np.linalg.norm(twist[0, 3:]) * time
    mujoco.mju_axisAngle2Quat(turn, twist[0, 3:] / np.linalg.norm(twist[0, 3:]), angle)
    mujoco.mju_mulQuat(turned, turn, data.mocap_quat[0])
    data.mocap_pos[0] += twist[0, :3] * time
    data.mocap_quat[0] = turned
    mujoco.mj_kinematics(model, data)
    return data


@pytest.mark.parametrize("kind", ["position", "workspace"])
def test_slopes_are_the_derivatives_of_the_distances(model: mujoco.MjModel, kind: str) -> None:
    rng = np.random.default_rng(0)
    twist = np.zeros((1, 6))
    barrier = barrier_of(kind, model, twist)
    for _ in range(20):
        q = random_configuration(model, model.qpos0, rng, 1.5)
        near = barrier.near(at(model, q), np.ones(model.nv), 0.01)
        assert near.distance == pytest.approx(barrier.distances(at(model, q), near.ids))
        for dof in range(model.nv):
            step = np.zeros(model.nv)
            step[dof] = STEP
            ahead = barrier.distances(moved(model, q, step), near.ids)
            behind = barrier.distances(moved(model, q, -step), near.ids)
            assert near.slope[:, dof] == pytest.approx(
                (ahead - behind) / (2 * STEP), abs=DIFFERENCE
            )


def test_drift_is_what_a_moving_base_adds(model: mujoco.MjModel) -> None:
    rng = np.random.default_rng(0)
    twist = rng.normal(size=(1, 6))
    barrier = barrier_of("workspace", model, twist)
    q = random_configuration(model, model.qpos0, rng, 1.0)
    near = barrier.near(at(model, q), np.ones(model.nv), 0.01)
    ahead = barrier.distances(spun(model, q, twist, STEP), near.ids)
    behind = barrier.distances(spun(model, q, twist, -STEP), near.ids)
    assert near.drift == pytest.approx((ahead - behind) / (2 * STEP), abs=DIFFERENCE)
    balls = barrier_of("position", model, twist)
    assert not balls.near(at(model, q), np.ones(model.nv), 0.01).drift.any()


@pytest.mark.parametrize("kind", ["position", "workspace"])
def test_no_step_takes_a_distance_further_than_its_reach(model: mujoco.MjModel, kind: str) -> None:
    rng = np.random.default_rng(0)
    twist, slide = np.zeros((1, 6)), model.joint("slide")
    barrier = barrier_of(kind, model, twist)
    tightest = np.inf
    for _ in range(300):
        size = 10.0 ** rng.uniform(-4, 0.5)
        q = random_configuration(model, model.qpos0, rng, 2.0)
        step = size * rng.normal(size=model.nv) * (rng.uniform(size=model.nv) < 0.5)
        q[slide.qposadr[0]] = np.clip(q[slide.qposadr[0]], *slide.range)
        step[slide.dofadr[0]] = 0.0
        ids = barrier.near(at(model, q), np.abs(step), 0.01).ids
        before = barrier.distances(at(model, q), ids)
        fall = before - barrier.distances(moved(model, q, step), ids)
        reach = barrier.reach(ids, np.abs(step), 0.01)
        assert (fall <= reach + ROUNDING).all()
        moves = np.abs(fall) > ROUNDING
        tightest = min([tightest, *(reach[moves] / np.abs(fall[moves]))])
    assert tightest < 2.0  # a bound, not just a large number


def test_the_reach_of_planes_counts_a_moving_base(model: mujoco.MjModel) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        twist = rng.normal(size=(1, 6))
        barrier = barrier_of("workspace", model, twist)
        q = random_configuration(model, model.qpos0, rng, 2.0)
        q[model.joint("slide").qposadr[0]] = 0.0
        ids = barrier.near(at(model, q), np.zeros(model.nv), 0.1).ids
        fall = barrier.distances(at(model, q), ids) - barrier.distances(
            spun(model, q, twist, 0.1), ids
        )
        assert (fall <= barrier.reach(ids, np.zeros(model.nv), 0.1) + ROUNDING).all()


def test_a_ball_at_rest_has_all_of_its_range(model: mujoco.MjModel) -> None:
    near = barrier_of("position", model, np.zeros((1, 6))).near(
        at(model, model.qpos0), np.ones(model.nv), 0.01
    )
    assert near.distance == pytest.approx([1.1, 0.5])
    assert np.linalg.norm(near.slope, axis=1) == pytest.approx([1.0, 1.0])


def test_the_angle_is_the_same_for_either_sign_of_the_quaternion(model: mujoco.MjModel) -> None:
    barrier = barrier_of("position", model, np.zeros((1, 6)))
    q = random_configuration(model, model.qpos0, np.random.default_rng(0), 1.0)
    there = barrier.near(at(model, q), np.ones(model.nv), 0.01)
    q[:4] *= -1.0
    here = barrier.near(at(model, q), np.ones(model.nv), 0.01)
    assert here.distance == pytest.approx(there.distance)
    assert here.slope == pytest.approx(there.slope)


def test_barriers_name_their_entries_and_their_least(model: mujoco.MjModel) -> None:
    balls = barrier_of("position", model, np.zeros((1, 6)))
    data = at(model, model.qpos0)
    assert [balls.name(i) for i in range(2)] == ["shoulder", "wrist"]
    assert balls.least(data) == pytest.approx((0.5, 1))
    planes = barrier_of("workspace", model, np.zeros((1, 6)))
    assert planes.name(0) == "site 'tip' and plane 1"
    height = data.site("tip").xpos[2] - 0.1
    assert planes.distances(data, np.array([0]))[0] == pytest.approx(height)
    assert planes.least(data)[0] == planes.distances(data, np.arange(3)).min()


def test_planes_with_different_gains_are_barriers_of_their_own(model: mujoco.MjModel) -> None:
    planes = ({**PLANES[0], "gain": 0.5}, *PLANES[1:])
    limits = LimitsModel.model_validate({"workspace": planes})
    found = compile_workspace(model, limits.workspace, np.arange(model.nv), [])
    assert [(spec.gain, len(spec.planes)) for spec in found] == [(0.5, 1), (0.9, 2)]


def test_ball_joints_that_cannot_move_have_no_row(model: mujoco.MjModel) -> None:
    wrist = model.joint("wrist").dofadr[0]
    (spec,) = compile_balls(model, LimitsModel(), np.arange(wrist, wrist + 3))
    assert [model.joint(joint).name for joint in spec.joints] == ["wrist"]
    assert compile_balls(model, LimitsModel(), np.arange(wrist)[3:]) == []


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ({"site": "hnd"}, "did you mean 'hand'"),
        ({"body": "world"}, "no joint that may move moves the body 'world'"),
    ],
)
def test_a_plane_that_nothing_can_keep_is_a_mistake(frame: dict[str, str], message: str) -> None:
    plane = {"frame": frame, "normal": [0, 0, 1], "offset": 0.0}
    with pytest.raises(ConfigError) as mistake:
        rmrc.compile(config(PANDA, [POSTURE], limits={"workspace": [plane]}))
    assert message in str(mistake.value)


@pytest.mark.parametrize("acceleration", ["off", {"default": 15.0}])
@pytest.mark.parametrize("dt", [0.002, 0.02, 0.1])
def test_the_hand_stays_in_front_of_its_planes(dt: float, acceleration: object) -> None:
    planes = [
        {"frame": {"site": "hand"}, "normal": [0, 0, 1], "offset": 0.3},
        {"frame": {"site": "hand"}, "normal": [0, -1, 0], "offset": -0.2},
    ]
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "gain": 20.0}
    controller = rmrc.Controller(
        rmrc.compile(
            config(PANDA, [hand], limits={"workspace": planes, "acceleration": acceleration})
        )
    )
    controller.set_target("hand", [0.5, 0.5, 0.1])
    y = z = np.nan
    for _ in range(int(3.0 / dt)):
        step = controller.step(dt=dt)
        _, y, z = controller.problem.forward(step.q)["hand"][:3, 3]
        kept = RELAXED if rmrc.Status.RELAXED in step.flags else KEPT
        assert z >= 0.3 - kept
        assert y <= 0.2 + kept
    assert y > 0.2 - NEAR
    assert z < 0.3 + NEAR


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.1])
def test_a_ball_joint_stays_in_its_range(tmp_path: Path, dt: float) -> None:
    (tmp_path / "chain.xml").write_text(CHAIN)
    hand = {"name": "hand", "type": "frame", "frame": {"site": "tip"}, "gain": 20.0}
    problem = rmrc.compile(config(str(tmp_path / "chain.xml"), [hand]))
    controller, model = rmrc.Controller(problem), problem.model
    rng = np.random.default_rng(0)
    balls = problem.barriers[0].build(model, np.zeros((1, 6)))
    closest = np.inf
    for _ in range(int(3.0 / dt)):
        if rng.uniform() < 2.0 * dt:
            controller.set_target("hand", rng.normal(size=3), rng.normal(size=4))
        step = controller.step(dt=dt)
        least, _ = balls.least(at(model, step.q))
        closest = min(closest, least)
    assert -KEPT <= closest < 0.01
