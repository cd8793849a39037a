"""`execute: actuated`: joint controllers in the physics, and what comes back from the joints."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from executed_runs import JOINT_CONTROLS, ROUNDING

import rmrc
from models import REPOSITORY
from rmrc.config.models import ActuationModel
from rmrc.control.controller import Controller
from rmrc.runs.check import check
from rmrc.runs.execution import build_execution

LINE = REPOSITORY / "configs" / "panda_line.yaml"
UR5E = REPOSITORY / "configs" / "ur5e_waypoints.yaml"
MOBILE = REPOSITORY / "configs" / "mobile_arm_reach.yaml"

# What the joint controllers must keep of the hand's path, m RMS.
TRACKING = 2e-3
# Where the hand must be at rest, m: well inside what the path's end leaves kinematically.
AT_REST = 5e-5
FEEDBACKS = ["measured", "commanded"]


def loaded(path: Path = LINE, **overrides: Any) -> rmrc.Config:
    """Load a configuration to be actuated; overrides of `actuation` by their own names."""
    options = ActuationModel.model_fields
    named = {(f"actuation.{k}" if k in options else k): v for k, v in overrides.items()}
    return rmrc.load(path, overrides={"execute": "actuated", **named})


def run(path: Path = LINE, **overrides: Any) -> rmrc.Run:
    return rmrc.solve(loaded(path, **overrides))


def hand_error(run: rmrc.Run) -> np.ndarray:
    return run.error[next(iter(run.error))][:, 0]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def altered(tmp_path: Path, scene: str, *changes: tuple[str, str]) -> str:
    """Write a copy of a scene with text replaced; return its path."""
    for source in (REPOSITORY / "scenes").rglob("*.xml"):
        text = source.read_text()
        for old, new in changes:
            text = text.replace(old, new)
        target = tmp_path / source.relative_to(REPOSITORY)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)
    return str(tmp_path / "scenes" / f"{scene}.xml")


WITHOUT_COMPENSATION = (' gravcomp="1"', "")


# Tracking


@pytest.mark.parametrize("feedback", FEEDBACKS)
@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
def test_the_line_is_kept(joint_control: str, feedback: str) -> None:
    line = run(joint_control=joint_control, feedback=feedback)
    assert line.summary["converged"]
    assert rms(hand_error(line)) < TRACKING
    assert line.q_commanded is not None
    assert not np.array_equal(line.q, line.q_commanded)


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
@pytest.mark.parametrize("path", [UR5E, MOBILE], ids=["ur5e", "mobile_arm"])
def test_other_robots_keep_their_paths(path: Path, joint_control: str) -> None:
    followed = run(path, joint_control=joint_control, dt=0.004)
    assert followed.summary["converged"]
    assert rms(hand_error(followed)) < TRACKING


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
@pytest.mark.parametrize("path", [LINE, UR5E])
@pytest.mark.parametrize(("dt", "latency"), [(0.001, 5), (0.005, 1)], ids=["1ms", "5ms"])
def test_the_loop_is_stable_with_a_latency_of_5_ms(
    path: Path, joint_control: str, dt: float, latency: int
) -> None:
    late = run(path, joint_control=joint_control, dt=dt, latency=latency)
    assert late.summary["converged"]
    assert rms(hand_error(late)) < TRACKING
    still = np.abs(late.v[late.time > late.time[-1] - 0.5])
    assert still.max() < 1e-3


@pytest.mark.parametrize("feedback", FEEDBACKS)
def test_computed_torques_carry_the_arm_without_compensation(feedback: str, tmp_path: Path) -> None:
    scene = altered(tmp_path, "panda", WITHOUT_COMPENSATION)
    line = run(scene=scene, feedback=feedback)
    assert line.summary["converged"]
    assert rms(hand_error(line)) < TRACKING


def test_measured_feedback_takes_back_what_position_servos_give_way(tmp_path: Path) -> None:
    scene = altered(tmp_path, "ur5e", WITHOUT_COMPENSATION)
    options = {"scene": scene, "joint_control": "position", "targets": {}, "duration": 3.0}
    final = {f: hand_error(run(UR5E, feedback=f, **options))[-1] for f in FEEDBACKS}
    assert final["commanded"] > 5e-3
    assert final["measured"] < AT_REST


def test_joints_left_out_of_the_dofs_are_held(tmp_path: Path) -> None:
    scene = altered(tmp_path, "panda", WITHOUT_COMPENSATION)
    moving = [f"joint{i}" for i in range(1, 7) if i != 3]
    held = run(scene=scene, dofs=moving, duration=1.0)
    assert np.abs(held.q[:, [2, 6]] - held.q[0, [2, 6]]).max() < 1e-3
    assert np.abs(np.diff(held.q, axis=0)).max() > 0


# Feedback


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
def test_commanded_feedback_sees_nothing_of_the_robot(joint_control: str) -> None:
    push = {"body": "gripper", "force": [0, 0, -300], "start": 0.1, "duration": 0.2}
    blind = run(
        joint_control=joint_control, feedback="commanded", noise=0.01, push=push, duration=0.5
    )
    kinematic = rmrc.solve(rmrc.load(LINE, overrides={"duration": 0.5}))
    assert np.array_equal(blind.v, kinematic.v)
    assert blind.q_commanded is not None
    assert np.abs(blind.q_commanded - kinematic.q).max() < ROUNDING
    assert np.abs(blind.q - kinematic.q).max() > 1e-4


def test_errors_velocities_and_configurations_are_those_of_the_robot() -> None:
    config = loaded(noise=0.01, latency=20, targets={}, duration=1.0)
    noisy, problem = rmrc.solve(config), rmrc.compile(config)
    wanted = problem.term["hand"].target[4:]
    for q, error in zip(noisy.q[::50], hand_error(noisy)[::50], strict=True):
        hand = problem.forward(q)["hand"][:3, 3]
        assert error == pytest.approx(np.linalg.norm(hand - wanted), abs=ROUNDING)
    assert hand_error(noisy).max() > 1e-4
    # MuJoCo's integrators move q by the new velocity.
    moved = np.diff(noisy.q, axis=0) / problem.dt
    assert np.abs(moved - noisy.v_measured[1:]).max() < ROUNDING


def test_the_error_of_a_velocity_task_is_that_of_the_robot() -> None:
    turn = {"name": "turn", "type": "velocity", "target": {"joint1": 0.5}}
    turning = run(tasks=[turn], targets={}, noise=0.01, duration=0.3)
    error = turning.error["turn"][:, 0]
    assert error[0] == 0.5
    assert np.abs(error - np.abs(0.5 - turning.v_measured[:, 0])).max() < ROUNDING
    assert error[-1] < 0.01


def measurements(latency: int, noise: float, steps: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Return what the steps got, and the true configurations, of a moving arm."""
    problem = rmrc.compile(loaded(latency=latency, noise=noise))
    execution, controller = build_execution(problem), Controller(problem)
    controller.set_target("hand", [0.5, 0.2, 0.4])
    targets = controller.engine.evaluation.target
    got, true = [], []
    for _ in range(steps):
        q = execution.feedback()
        assert q is not None
        step = controller.step(q)
        got.append(q)
        true.append(execution.state(step, targets).q.copy())
        execution.carry_out(step)
    return np.array(got), np.array(true)


@pytest.mark.parametrize("latency", [0, 1, 7])
def test_a_measurement_is_late_by_exactly_the_latency(latency: int) -> None:
    got, true = measurements(latency, 0.0)
    assert np.array_equal(got[latency:], true[: len(true) - latency])
    assert np.array_equal(got[:latency], np.tile(true[0], (latency, 1)))
    assert (np.diff(true[5:], axis=0).any(axis=1)).all()


def test_noise_is_normal_with_the_deviation_asked_for() -> None:
    got, true = measurements(0, 0.01, steps=500)
    noise = (got - true) / 0.01
    # 3500 samples: their mean is within 4/√3500 of 0, their deviation within 4/√7000 of 1.
    assert abs(noise.mean()) < 4 / np.sqrt(noise.size)
    assert abs(noise.std() - 1.0) < 4 / np.sqrt(2 * noise.size)
    assert abs(np.mean(np.abs(noise) < 1.0) - 0.683) < 0.03
    white = np.mean(noise[1:] * noise[:-1])
    assert abs(white) < 4 / np.sqrt(noise.size)


def test_a_seed_gives_the_same_run_bit_for_bit_and_another_seed_another() -> None:
    push = {"body": "link5", "torque": [0, 0, 5], "start": 0.2, "duration": 0.1}
    options = {"noise": 1e-3, "latency": 2, "push": push, "duration": 0.6}
    first, second = (run(seed=3, **options) for _ in range(2))
    other = run(seed=4, **options)
    for name in ("time", "q", "v", "v_measured", "q_commanded", "status", "active", "kkt"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    assert np.array_equal(hand_error(first), hand_error(second))
    assert not np.array_equal(first.q, other.q)
    assert (first.manifest["seed"], other.manifest["seed"]) == (3, 4)


# The push, and what cannot be followed


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
def test_a_push_displaces_the_arm_and_it_comes_back(joint_control: str) -> None:
    push = {"body": "wrist_3_link", "force": [60, 0, 0], "start": 0.5, "duration": 0.25}
    still = {"joint_control": joint_control, "targets": {}, "duration": 2.5}
    pushed, calm = run(UR5E, push=push, **still), run(UR5E, **still)
    error = hand_error(pushed)
    before = pushed.time <= 0.5
    assert np.array_equal(pushed.q[before], calm.q[before])
    assert error[~before].max() > 1e-3
    assert pushed.time[error.argmax()] < 0.85
    assert error[-1] < AT_REST


@pytest.mark.parametrize("joint_control", JOINT_CONTROLS)
def test_set_points_do_not_wind_up_where_the_force_saturates(joint_control: str) -> None:
    push = {"body": "wrist_3_link", "force": [0, 0, -400], "start": 0.5, "duration": 1.0}
    pushed = run(UR5E, joint_control=joint_control, targets={}, push=push, duration=4.0)
    error, after = hand_error(pushed), pushed.time > 1.5
    assert error[~after].max() > 0.4
    # Wound up, the arm would be thrown twice as far once it is let go.
    assert error[after].max() < 1.25 * error[~after].max()
    assert error[-1] < AT_REST


@pytest.mark.parametrize("end", [-1, 1])
@pytest.mark.parametrize(("dt", "latency"), [(0.002, 0), (0.002, 3), (0.01, 1)])
def test_a_joint_at_the_end_of_its_range_stands_still(dt: float, latency: int, end: int) -> None:
    posture = {"name": "p", "type": "posture", "target": {"joint1": 3.5 * end, "joint4": -1.5}}
    stopped = run(dt=dt, latency=latency, tasks=[posture], targets={}, duration=3.0)
    late = stopped.time > 2.5
    assert stopped.q[-1, 0] == pytest.approx(end * (2.8973 - 0.01), abs=1e-3)
    assert np.ptp(stopped.v[late], axis=0).max() < 1e-3


DIVERGING = {"body": "gripper", "force": [1e15, 0, 0], "start": 0.1, "duration": 0.1}


def test_a_simulation_that_fails_ends_the_run_with_a_notice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    failed = run(push=DIVERGING, duration=1.0)
    assert failed.time[-1] == pytest.approx(0.1)
    assert not failed.summary["converged"]
    assert "the simulation failed" in failed.manifest["notices"][0]
    assert "unstable" in failed.manifest["notices"][0]
    assert all(np.isfinite(array).all() for array in (failed.q, failed.v, failed.v_measured))
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_simulation_that_fails_exits_1_with_the_run_saved(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rmrc", "solve", LINE, "--out", "run", "--json"]
    settings = {"execute": "actuated", "actuation.push": json.dumps(DIVERGING)}
    for setting in settings.items():
        command += ["--set", "=".join(setting)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout)["converged"] is False
    assert done.stderr == ""
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert len(rmrc.Run.load(tmp_path / "run").time) == 51


# The record


def test_set_points_are_recorded_where_there_are_any(tmp_path: Path) -> None:
    actual = run(duration=0.1)
    loaded = rmrc.Run.load(actual.save(tmp_path / "actuated", report=False))
    assert actual.q_commanded is not None
    assert loaded.q_commanded is not None
    assert np.array_equal(actual.q_commanded, loaded.q_commanded)
    kinematic = rmrc.solve(rmrc.load(LINE, overrides={"duration": 0.1}))
    assert kinematic.q_commanded is None
    loaded = rmrc.Run.load(kinematic.save(tmp_path / "kinematic", report=False))
    assert loaded.q_commanded is None


# What cannot be


def mistake(path: Path, **overrides: Any) -> str:
    with pytest.raises(rmrc.ConfigError) as caught:
        check(loaded(path, **overrides))
    return str(caught.value)


def test_a_floating_base_is_refused() -> None:
    biped = REPOSITORY / "configs" / "biped_balance.yaml"
    for joint_control in JOINT_CONTROLS:
        assert re.match(
            "--set execute=.*floating base", mistake(biped, joint_control=joint_control)
        )


def test_joints_without_a_position_actuator_are_named(tmp_path: Path) -> None:
    scene = altered(
        tmp_path,
        "panda",
        ('<position class="panda" name="joint2" joint="joint2"/>', '<motor joint="joint2"/>'),
        ('<position class="panda_wrist" name="joint6"', '<velocity name="joint6"'),
    )
    message = mistake(LINE, scene=scene, joint_control="position")
    assert "joints without a position actuator: joint2, joint6; leave" in message
    assert message.startswith("--set actuation.joint_control=position: ")
    moving = [f"joint{i}" for i in (1, 3, 4, 5, 7)]
    check(loaded(scene=scene, joint_control="position", dofs=moving))
    assert rms(hand_error(run(scene=scene, joint_control="torque", duration=1.0))) < TRACKING


def test_other_mistakes_have_their_place(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    text = (REPOSITORY / "configs" / "panda_actuated.yaml").read_text()
    text = text.replace("../", f"{REPOSITORY}/").replace("gripper", "link0")
    file.write_text(text.replace("feedback: measured ", "bandwidth: 1000.0"))
    with pytest.raises(rmrc.ConfigError) as caught:
        check(rmrc.load(file))
    bandwidth, push = (m for m in str(caught.value).splitlines() if "config.yaml" in m)
    assert "config.yaml:10:14: in steps of 2 ms, the physics is stable up to" in bandwidth
    assert "config.yaml:14:16: body 'link0' is fixed to the world" in push
    assert "did you mean 'gripper'?" in mistake(LINE, push={"body": "griper", "duration": 1.0})
    # As many measurements as steps of latency are kept.
    assert "10000" in mistake(LINE, latency=10**10)


def test_a_dt_that_is_no_multiple_of_the_timestep_is_said_and_kept() -> None:
    for dt, said in ((0.002, None), (0.006, None), (0.001, "1 ms"), (0.005, "1.667 ms")):
        config = loaded(dt=dt, duration=0.6)
        notices = [line for line in check(config) if "the physics runs in steps of" in line]
        assert [f"in steps of {said}:" in line for line in notices] == ([True] if said else [])
        followed = rmrc.solve(config)
        assert notices == [n for n in followed.manifest["notices"] if "the physics runs" in n]
        # The physics takes the time of the step, no more and no less.
        moved = np.diff(followed.q, axis=0) / dt
        mean = 0.5 * (followed.v_measured[1:] + followed.v_measured[:-1])
        assert np.abs(moved - mean).max() < 0.02 * np.abs(mean).max()
