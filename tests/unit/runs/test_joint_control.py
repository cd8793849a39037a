"""What the joints of a simulated robot are commanded."""

import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest
from executed_runs import JOINT_CONTROLS, ROUNDING, moving

import rmrc
from models import REPOSITORY, config
from rmrc.runs.execution import build_execution
from rmrc.runs.joint_control import ComputedTorque, PositionServos, highest_bandwidth, torque_limits

TORQUE_SCENE = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body gravcomp="{gravcomp}">
      <joint name="a" axis="0 1 0" range="-2 2" stiffness="3" damping="0.7" armature="0.1"
        actuatorgravcomp="{actuator}"/>
      <geom type="capsule" fromto="0 0 0 0.4 0.1 0" size="0.03" contype="0" conaffinity="0"/>
      <body pos="0.4 0.1 0">
        <joint name="b" type="slide" axis="1 0 1" range="-0.2 0.2" springref="0.1" stiffness="9"/>
        <geom type="sphere" size="0.05" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="a"/> <position joint="a" kp="100"/> <velocity joint="b" kv="10"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("gravcomp", "actuator"), [(0, "false"), (1, "false"), (1, "true")])
def test_computed_torques_give_the_acceleration_asked_for(
    gravcomp: int, actuator: str, seed: int
) -> None:
    xml = TORQUE_SCENE.format(gravcomp=gravcomp, actuator=actuator)
    model = mujoco.MjModel.from_xml_string(xml)
    joints = ComputedTorque(model, np.arange(2), bandwidth=30.0, damping_ratio=0.8)
    data, q, v = moving(model, seed)
    mujoco.mj_step1(model, data)
    joints.drive(data, q, v)
    mujoco.mj_forward(model, data)
    wanted = 30.0**2 * (q - data.qpos) + 2 * 0.8 * 30.0 * (v - data.qvel)
    np.testing.assert_allclose(data.qacc, wanted, rtol=ROUNDING)


SERVO_SCENE = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body>
      <joint name="a" axis="0 1 0" range="-2 2"/> <geom type="capsule" size="0.03 0.2"/>
      <body pos="0 0 0.5">
        <joint name="b" type="slide" axis="1 0 0" range="-1 1"/> <geom type="sphere" size="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="a" gear="0.001"/>
    <position joint="a" kp="200" kv="10" gear="3"/>
    <general joint="b" gaintype="fixed" gainprm="50" biastype="affine" biasprm="4 -80 -6"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize("seed", range(3))
def test_position_actuators_pull_towards_the_moving_set_point(seed: int) -> None:
    model = mujoco.MjModel.from_xml_string(SERVO_SCENE)
    data, q, v = moving(model, seed)
    PositionServos(model).drive(data, q, v)
    mujoco.mj_forward(model, data)
    stiffness, damping = np.array([200 * 9, 80]), np.array([10 * 9, 6])
    wanted = stiffness * (q - data.qpos) + damping * (v - data.qvel)
    np.testing.assert_allclose(data.qfrc_actuator, wanted, rtol=ROUNDING)
    assert data.ctrl[0] == 0.0


# An arm with a joint that nothing drives, a drawer with a motor, a ball that lies nowhere.
BENCH = """
<mujoco>
  <compiler angle="radian"/> <option integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="a" axis="0 1 0" range="-2 2" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/> <site name="hand" pos="0.4 0 0"/>
      <body name="tassel" pos="0.4 0 0">
        <joint name="free_to_swing" axis="0 1 0"/>
        <geom type="capsule" fromto="0.05 0 0 0.2 0 0" size="0.02"/>
      </body>
    </body>
    <body name="drawer" pos="0 2 0">
      <joint name="drawer" type="slide" axis="1 0 0"/> <geom size="0.1"/>
    </body>
    <body name="ball" pos="0 -2 9"><freejoint name="ball"/><geom size="0.1"/></body>
  </worldbody>
  <actuator>
    <position joint="a" kp="500" kv="40"/> <motor joint="drawer"/>
  </actuator>
  <keyframe><key name="home" qpos="0.3 0.5 0 0 -2 9 1 0 0 0" ctrl="0.3 40"/></keyframe>
</mujoco>
"""


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
def test_what_no_controller_drives_goes_its_own_way(joint_control: str, tmp_path: Path) -> None:
    (tmp_path / "bench.xml").write_text(BENCH)
    bench = config(
        str(tmp_path / "bench.xml"),
        [{"name": "p", "type": "posture"}],
        dofs=["a"],
        duration=0.5,
        execute="actuated",
        actuation={"joint_control": joint_control, "noise": 1e-3},
    )
    done = rmrc.solve(bench)
    a, swinging, drawer, *_, height = done.q[-1, :6]
    assert abs(a - 0.3) < 0.05
    assert abs(swinging - 0.5) > 0.1
    assert height == pytest.approx(9 - 0.5 * 9.81 * 0.5**2, rel=1e-2)
    # Its actuator keeps the keyframe's control, unless computed torques stand in its place.
    assert drawer > 0.5 if joint_control == "position" else abs(drawer) < 1e-3
    problem = rmrc.compile(bench)
    measured = build_execution(problem).feedback()
    assert measured is not None
    assert np.array_equal(measured[3:], problem.start[3:])
    assert (measured[:3] != problem.start[:3]).all()


def test_computed_torques_leave_undriven_joints_alone() -> None:
    model = mujoco.MjModel.from_xml_string(BENCH)
    joints = ComputedTorque(model, np.array([0]), bandwidth=30.0, damping_ratio=1.0)
    data, torques = mujoco.MjData(model), []
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step1(model, data)
    for elsewhere in (0.0, 0.4):
        q = data.qpos.copy()
        q[:2] += (0.01, elsewhere)
        joints.drive(data, q, np.zeros(model.nv))
        torques.append(data.qfrc_applied.copy())
    assert np.array_equal(*torques)
    assert np.flatnonzero(torques[0]).tolist() == [0]


def test_torques_keep_the_limits_of_the_model_where_the_reach_ends() -> None:
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    model = mujoco.MjModel.from_xml_path(scene)
    limits = np.array([87.0] * 4 + [12.0] * 3)
    assert np.array_equal(torque_limits(model), limits)
    model.jnt_actfrclimited[3], model.jnt_actfrcrange[3] = True, (-40, 40)
    limits[3] = 40.0
    assert np.array_equal(torque_limits(model), limits)
    driven = copy.copy(model)
    joints = ComputedTorque(driven, np.arange(7), bandwidth=50.0, damping_ratio=1.0)
    data, *_ = moving(driven, seed=0)
    mujoco.mj_step1(driven, data)
    joints.drive(data, data.qpos + 1.0, np.zeros(7))
    assert np.abs(data.qfrc_applied).max() <= 87.0
    assert (np.abs(data.qfrc_applied) <= limits).all()
    inertia = np.empty((7, 7))
    for column, unit in zip(inertia, np.eye(7), strict=True):
        mujoco.mj_mulM(driven, data, column, unit)
    diagonal = np.diagonal(inertia)
    np.testing.assert_allclose(joints.reach(data), limits / (50.0**2 * diagonal), rtol=ROUNDING)
    servos = PositionServos(model)
    np.testing.assert_allclose(servos.reach(data), limits / ([2000] * 4 + [500] * 3))


def test_actuators_of_one_joint_give_their_torques_together() -> None:
    model = mujoco.MjModel.from_xml_string(SERVO_SCENE)
    assert np.isinf(torque_limits(model)).all()
    assert np.isinf(PositionServos(model).reach(mujoco.MjData(model))).all()
    model.actuator_gear[0, 0] = -2.0
    model.actuator_forcelimited[:2], model.actuator_forcerange[:2] = True, [(-4, 5), (-10, 10)]
    assert torque_limits(model).tolist() == [2 * 5 + 3 * 10, np.inf]
    reach = PositionServos(model).reach(mujoco.MjData(model))
    assert reach.tolist() == [40 / (200 * 3**2), np.inf]


@pytest.mark.parametrize("damping_ratio", [0.3, 1.0, 2.0])
def test_the_highest_bandwidth_is_where_the_steps_become_unstable(damping_ratio: float) -> None:
    h = 0.002
    for share, stable in ((0.999, True), (1.001, False)):
        omega = share * highest_bandwidth(damping_ratio, h)
        rate = np.array([-h * omega**2, 1.0 - 2.0 * damping_ratio * omega * h])
        steps = np.array([[1.0, 0.0] + h * rate, rate])
        assert (np.abs(np.linalg.eigvals(steps)).max() < 1.0) == stable
