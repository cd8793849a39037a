"""Where the limits of the joints come from: the configuration, the model, its actuators."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc.errors import ConfigError
from rmrc.limits.ball import BallRanges
from rmrc.limits.joints import HINGE_SPEED, SLIDE_SPEED
from rmrc.problem.problem import Problem
from rmrc.record.manifest import manifest

BIPED = str(REPOSITORY / "scenes" / "biped.xml")

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <default><geom type="sphere" size="0.1" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="base">
      <joint name="rail" type="slide" range="-1 1"/><geom/>
      <body name="first">
        <joint name="free_turn" axis="0 1 0"/><geom/>
        <body name="second">
          <joint name="elbow" axis="0 1 0" range="-2 2"/><geom/>
          <body name="third">
            <joint name="socket" type="ball" range="0 0.8"/><geom/>
            <body name="fourth"><joint name="wrist" axis="1 0 0" range="-3 3"/><geom/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""


@pytest.fixture
def problem(tmp_path: Path):
    def compiled(actuators: str = "", **limits: Any) -> Problem:
        path = tmp_path / "arm.xml"
        path.write_text(ARM.format(actuators=actuators))
        return rmrc.compile(config(str(path), [{"name": "p", "type": "posture"}], limits=limits))

    return compiled


def limits_of(problem: Problem, joint: str) -> dict[str, float]:
    dof, box = problem.model.joint(joint).dofadr[0], problem.box
    return {
        name: float(getattr(box, name)[dof])
        for name in ("lower", "upper", "velocity", "acceleration", "jerk")
    }


def range_of(problem: Problem, joint: str) -> tuple[float, float]:
    found = limits_of(problem, joint)
    return found["lower"], found["upper"]


def joints_of(problem: Problem) -> dict[str, dict[str, Any]]:
    return {joint["name"]: joint for joint in manifest(problem, [])["model"]["joints"]}


def said(problem: Problem, text: str) -> str:
    (notice,) = (notice for notice in problem.notices if text in notice)
    return notice


def test_ranges_come_from_the_model_by_default(problem) -> None:
    found = problem()
    assert range_of(found, "rail") == (-1.0, 1.0)
    assert range_of(found, "free_turn") == (-np.inf, np.inf)
    assert "on by default" in said(found, "position limits")
    assert said(found, "no range").endswith(": free_turn")


def test_ranges_by_name_replace_those_of_the_model(problem) -> None:
    found = problem(position={"margin": 0.1, "elbow": [-3, 0.5], "free_turn": [-1, 1]})
    assert range_of(found, "elbow") == pytest.approx((-2.9, 0.4))
    assert range_of(found, "free_turn") == pytest.approx((-0.9, 0.9))
    assert range_of(found, "rail") == pytest.approx((-0.9, 0.9))
    # The record has them as they were given, without the margin.
    assert joints_of(found)["elbow"]["range"] == [-3.0, 0.5]
    assert said(found, "from the configuration").endswith(": free_turn, elbow")


def test_a_range_of_one_point_holds_the_joint(problem) -> None:
    assert range_of(problem(position={"elbow": [0.5, 0.5]}), "elbow") == (0.5, 0.5)


def test_position_actuators_narrow_the_ranges(problem) -> None:
    found = problem(
        '<position joint="elbow" kp="10" gear="2" ctrlrange="-2 8"/>'
        '<position joint="free_turn" kp="10" kv="1" gear="-1" ctrlrange="-1 2"/>'
        '<position joint="rail" kp="10" ctrlrange="-5 5"/>'
    )
    assert range_of(found, "elbow") == (-1.0, 2.0)
    assert range_of(found, "free_turn") == (-2.0, 1.0)
    assert range_of(found, "rail") == (-1.0, 1.0)
    assert said(found, "position actuators").endswith(": free_turn, elbow")
    assert joints_of(found)["free_turn"]["range"] == [-2.0, 1.0]


def test_all_position_actuators_of_a_joint_count(problem) -> None:
    found = problem(
        '<position joint="elbow" kp="10" ctrlrange="-1 2"/>'
        '<position joint="elbow" kp="10" ctrlrange="-2 0.5"/>'
    )
    assert range_of(found, "elbow") == (-1.0, 0.5)


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor joint="elbow" ctrlrange="-1 1"/>',
        '<position joint="elbow" kp="10" inheritrange="1"/>',
        '<position joint="elbow" kp="10" ctrlrange="-1 1" ctrllimited="false"/>',
        '<intvelocity joint="elbow" kp="10" actrange="-1 1" ctrlrange="-1 1"/>',
        '<general joint="elbow" gainprm="10" biastype="affine" biasprm="1 -10 0"'
        ' ctrlrange="-1 1"/>',
        '<general joint="elbow" gainprm="10" biastype="affine" biasprm="0 -5 0" ctrlrange="-1 1"/>',
    ],
)
def test_other_actuators_say_nothing_about_the_range(problem, actuator: str) -> None:
    found = problem(actuator)
    assert range_of(found, "elbow") == (-2.0, 2.0)
    assert not any("control range" in notice for notice in found.notices)


def test_the_configuration_goes_before_the_actuators(problem) -> None:
    found = problem(
        '<position joint="elbow" kp="10" ctrlrange="-1 1"/>', position={"elbow": [-1.5, 0]}
    )
    assert range_of(found, "elbow") == (-1.5, 0.0)


def test_a_control_range_apart_from_the_joint_is_not_held(problem) -> None:
    found = problem('<position joint="elbow" kp="10" ctrlrange="3 4"/>')
    assert range_of(found, "elbow") == (-2.0, 2.0)
    assert said(found, "nothing in common").endswith(": elbow")


def test_velocity_actuators_give_the_unstated_velocity_limits(problem) -> None:
    actuators = (
        '<velocity joint="elbow" kv="5" gear="2" ctrlrange="-4 6"/>'
        '<velocity joint="rail" kv="5" ctrlrange="0 6"/>'
        '<velocity joint="wrist" kv="5" ctrlrange="-9 9"/>'
    )
    found = problem(actuators, velocity={"wrist": 1.0})
    assert limits_of(found, "elbow")["velocity"] == 2.0
    assert limits_of(found, "wrist")["velocity"] == 1.0
    assert limits_of(found, "rail")["velocity"] == SLIDE_SPEED
    assert limits_of(found, "free_turn")["velocity"] == HINGE_SPEED
    assert said(found, "velocity actuators").endswith(": elbow")
    assert said(found, "capped").endswith(": rail, free_turn, socket")
    stated = problem(actuators, velocity={"default": 7.0})
    assert limits_of(stated, "elbow")["velocity"] == 7.0
    assert limits_of(problem(actuators, velocity="off"), "elbow")["velocity"] == np.inf


def test_acceleration_and_jerk_are_per_joint(problem) -> None:
    found = problem(
        acceleration={"default": 10.0, "elbow": 5.0, "socket": 3.0}, jerk={"elbow": 500.0}
    )
    assert limits_of(found, "elbow")["acceleration"] == 5.0
    assert limits_of(found, "elbow")["jerk"] == 500.0
    assert limits_of(found, "rail")["jerk"] == np.inf
    first = found.model.joint("socket").dofadr[0]
    assert found.box.acceleration[first : first + 3].tolist() == [3.0] * 3
    assert joints_of(found)["elbow"]["jerk"] == 500.0
    assert joints_of(found)["rail"]["jerk"] is None


def test_ball_joints_have_their_range_as_a_barrier(problem) -> None:
    (balls,) = problem(position={"margin": 0.1}).barriers
    assert isinstance(balls, BallRanges)
    assert balls.largest == pytest.approx([0.7])
    (named,) = problem(position={"socket": [0, 1.5]}).barriers
    assert isinstance(named, BallRanges)
    assert named.largest == pytest.approx([1.5])
    assert joints_of(problem())["socket"]["range"] == [0.0, 0.8]
    assert problem(position="off").barriers == ()


def test_position_off_holds_no_range(problem) -> None:
    found = problem(position="off")
    assert range_of(found, "rail") == (-np.inf, np.inf)
    assert joints_of(found)["rail"]["range"] is None
    assert "position limits are off" in found.notices


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"position": {"elbo": [0, 1]}}, "did you mean 'elbow'"),
        ({"position": {"socket": [-1, 1]}}, "its range is [0, its largest angle]"),
        ({"position": {"margin": 0.9}}, "joint 'socket' has a range of 0.8, too short"),
        ({"position": {"margin": 1.1}}, "joint 'rail' has a range of 2, too short"),
        ({"position": {"elbow": [0, 0.1], "margin": 0.1}}, "joint 'elbow' has a range of 0.1"),
        ({"jerk": {"elbo": 5.0}}, "did you mean 'elbow'"),
    ],
)
def test_what_does_not_fit_the_model_is_a_mistake(problem, limits, message: str) -> None:
    with pytest.raises(ConfigError) as mistake:
        problem(**limits)
    assert message in str(mistake.value)


def biped(**limits: Any) -> Problem:
    return rmrc.compile(config(BIPED, [{"name": "p", "type": "posture"}], limits=limits))


def test_a_floating_base_has_speed_limits_of_its_own() -> None:
    found = biped(base={"linear": 0.5, "angular": 1.5}, velocity="off")
    assert found.box.velocity[:7].tolist() == [0.5] * 3 + [1.5] * 3 + [np.inf]
    assert not any("floating base" in notice for notice in found.notices)
    base = next(joint for joint in joints_of(found).values() if joint["type"] == "free")
    assert base["velocity"] == [0.5, 1.5]


def test_a_floating_base_without_speed_limits_is_spoken_of() -> None:
    found = biped(velocity={"default": 2.0}, acceleration={"default": 5.0})
    assert np.isinf(found.box.velocity[:6]).all()
    assert np.isinf(found.box.acceleration[:6]).all()
    assert "the floating base has no speed limit" in found.notices
    assert "the floating base has no angular speed limit" in biped(base={"linear": 1.0}).notices
    base = next(joint for joint in joints_of(found).values() if joint["type"] == "free")
    assert base["velocity"] == [None, None]


def test_a_limit_by_joint_is_not_for_a_floating_base() -> None:
    name = biped().model.joint(0).name
    for key, value in {"velocity": 1.0, "jerk": 1.0, "position": [0, 1]}.items():
        with pytest.raises(ConfigError, match="is a floating base, not a joint"):
            biped(**{key: {name: value}})


def test_base_speeds_of_a_fixed_robot_are_spoken_of(problem) -> None:
    said(problem(base={"linear": 1.0}), "no floating base")


def test_limits_are_kept_in_a_run_and_recorded(problem) -> None:
    scene = problem(
        velocity={"default": 1.0},
        acceleration={"default": 4.0},
        jerk={"default": 80.0},
        position={"rail": [-0.3, 0.2]},
    ).config
    fast = {"name": "p", "type": "posture", "gain": 50.0, "target": [5.0, 5, 5, 1, 0, 0, 0, 5]}
    run = rmrc.solve(
        rmrc.Config.model_validate(
            {**scene.model_dump(), "tasks": [fast], "dt": 0.004, "duration": 2.0}
        )
    )
    for kind in ("position", "velocity", "acceleration", "jerk"):
        assert run.summary["limits"][kind]["max_violation"] == 0.0
    jerk = np.diff(run.v, n=2, axis=0, prepend=np.zeros((2, run.v.shape[1]))) / 0.004**2
    assert np.abs(jerk).max() == pytest.approx(80.0)
    assert run.q[-1, 0] == pytest.approx(0.2, abs=1e-6)
