"""The tasks for the null space: gradients by finite differences, and what they do below a frame."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from nullspace_models import (
    CENTRAL_DIFFERENCE,
    ROUNDING,
    error_at,
    evaluation_of,
    signed_distance,
    slope,
    written,
)

import rmrc
from models import config, random_configuration, scene_path
from rmrc.problem.evaluation import Evaluation
from rmrc.tasks.manipulability import Manipulability, ManipulabilityTerm

# Largest position error in m of a frame above a soft task, whose weight is 1e-3 of the frame's.
TRACKING = 1e-4

BALL_JOINTS = """
<mujoco>
  <worldbody>
    <body>
      <joint type="ball"/>
      <geom type="capsule" fromto="0 0 0 .4 .1 .05" size=".03"/>
      <body pos=".4 .1 .05">
        <joint axis=".2 1 .1"/>
        <joint type="slide" axis="1 .2 0"/>
        <joint axis="1 .2 .1" pos=".02 .01 .1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 .1" size=".03"/>
        <body pos=".3 0 .1">
          <joint type="ball" pos=".05 0 0"/>
          <geom type="capsule" fromto="0 0 0 .1 0 .1" size=".03"/>
          <site name="tip" pos=".1 .02 .1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


# Centering.


@pytest.mark.parametrize("robot", ["pendulum", "panda", "mobile_arm", "biped"])
def test_centering_descends_the_shares_of_the_half_ranges(robot: str, tmp_path: Path) -> None:
    weight = 3.0
    evaluation = evaluation_of(scene_path(robot, tmp_path), {"type": "centering", "B": weight})
    model = evaluation.model
    scalar = np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE])
    limited = np.flatnonzero(model.jnt_limited.astype(bool) & scalar)
    low, high = model.jnt_range[limited].T

    def potential(data: mujoco.MjData) -> float:
        share = (data.qpos[model.jnt_qposadr[limited]] - 0.5 * (low + high)) / (0.5 * (high - low))
        return 0.5 * weight * float(share @ share)

    q = random_configuration(model, evaluation.problem.start, np.random.default_rng(0), 0.7)
    expected = -slope(evaluation, potential, q)
    term = evaluation.problem.terms[0]
    assert np.abs(term.weight * error_at(evaluation, q) - expected).max() < CENTRAL_DIFFERENCE
    assert np.count_nonzero(term.weight) == len(limited)


def test_a_centred_joint_goes_to_its_middle_at_the_gain() -> None:
    gain, duration = 2.0, 1.0
    start, damping = [1.0, -0.5], {"lambda": 0.0}
    task = {"name": "task", "type": "centering", "gain": gain}
    scene = scene_path("planar_2r", Path())  # whose ranges are symmetric
    run = rmrc.solve(config(scene, [task], start=start, duration=duration, damping=damping))
    # Euler steps of dt = 2 ms differ from the exponential by about ½ K² dt t of it, 0.4 %.
    assert run.q[-1] == pytest.approx(np.exp(-gain * duration) * np.array(start), rel=0.005)
    assert run.error["task"][0, 0] == pytest.approx(np.linalg.norm(start))


def test_centering_of_named_joints_leaves_the_others_alone() -> None:
    scene = scene_path("panda", Path())
    evaluation = evaluation_of(scene, {"type": "centering", "joints": ["joint4", "joint6"]})
    assert np.flatnonzero(evaluation.problem.terms[0].weight).tolist() == [3, 5]


# Manipulability.

# Robot, site, part, and how many singular values of its rows are not zero everywhere.
MANIPULABILITIES = [
    ("planar_2r", "hand", "position", 2),
    ("planar_3r", "hand", "position", 2),
    ("planar_4r", "hand", "both", 3),
    ("panda", "hand", "position", 3),
    ("panda", "hand", "orientation", 3),
    ("panda", "hand", "both", 6),
    ("ur5e", "tool", "both", 6),
    ("mobile_arm", "arm_hand", "both", 6),
    ("biped", "left_hand", "position", 3),
    ("biped", "left_hand", "both", 6),
    ("ball_joints", "tip", "position", 3),
    ("ball_joints", "tip", "both", 6),
]
ROWS = {"position": slice(0, 3), "orientation": slice(3, 6), "both": slice(0, 6)}


def scene_of(robot: str, folder: Path) -> str:
    return written(folder, BALL_JOINTS) if robot == "ball_joints" else scene_path(robot, folder)


def measure_of(evaluation: Evaluation) -> Manipulability:
    problem, term = evaluation.problem, evaluation.problem.terms[0]
    assert isinstance(term, ManipulabilityTerm)
    dofs = np.intersect1d(term.dofs, problem.dofs)
    return Manipulability(problem.model, problem.start, term.frame, term.part, dofs)


def manipulability(data: mujoco.MjData, site: str, part: str, rank: int) -> float:
    """Return the product of the largest singular values of a site's J without a floating base."""
    model = data.model
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(site).id)
    jacobian[:, model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_FREE] = 0.0
    return float(np.linalg.svd(jacobian[ROWS[part]], compute_uv=False)[:rank].prod())


@pytest.mark.parametrize(("robot", "site", "part", "rank"), MANIPULABILITIES)
def test_manipulability_climbs_its_gradient(
    robot: str, site: str, part: str, rank: int, tmp_path: Path
) -> None:
    task = {"type": "manipulability", "frame": {"site": site}, "part": part}
    evaluation = evaluation_of(scene_of(robot, tmp_path), task)
    measure = measure_of(evaluation)
    assert measure.rank == rank
    for seed in range(3):
        rng = np.random.default_rng(seed)
        q = random_configuration(evaluation.model, evaluation.problem.start, rng, 0.7)
        expected = slope(evaluation, lambda data: manipulability(data, site, part, rank), q)
        climbed = measure.largest * error_at(evaluation, q)
        assert np.abs(climbed - expected).max() < CENTRAL_DIFFERENCE
        assert np.abs(climbed).max() > 1e-3


def test_manipulability_of_a_2r_arm_is_its_sine() -> None:
    """w = |sin q2| for unit links, so that w₀ is near 1 and e = (0, cos q2)/w₀."""
    task = {"type": "manipulability", "frame": {"site": "hand"}}
    evaluation = evaluation_of(scene_path("planar_2r", Path()), task)
    largest = measure_of(evaluation).largest
    assert 0.9 < largest <= 1.0 + ROUNDING
    for elbow in (0.3, 1.2, 2.5):
        error = error_at(evaluation, np.array([0.4, elbow]))
        assert error == pytest.approx([0.0, np.cos(elbow) / largest], abs=ROUNDING)


def test_manipulability_stays_bounded_up_to_a_singularity_and_is_zero_there() -> None:
    task = {"type": "manipulability", "frame": {"site": "hand"}}
    evaluation = evaluation_of(scene_path("planar_3r", Path()), task)
    far, near = (error_at(evaluation, np.array([0.3, elbow, elbow])) for elbow in (1e-4, 1e-7))
    assert near == pytest.approx(far, rel=1e-3, abs=1e-3)  # both within about 1e-4 of the limit
    assert np.abs(near).max() > 0.1
    assert not error_at(evaluation, np.array([0.3, 0.0, 0.0])).any()


def test_manipulability_is_that_of_the_dofs_that_may_move() -> None:
    arm = [f"arm_joint{i}" for i in range(1, 8)]
    task = {"type": "manipulability", "part": "both"}
    alone = evaluation_of(scene_path("panda", Path()), {**task, "frame": {"site": "hand"}})
    scene = scene_path("mobile_arm", Path())
    mounted = evaluation_of(scene, {**task, "frame": {"site": "arm_hand"}}, dofs=arm)
    q = np.array([0.5, 0.4, -0.8, -2.4, 0.6, 2.2, 0.9])
    at = mounted.problem.start.copy()
    at[:3], at[3:] = (1.0, -2.0, 0.7), q
    error = error_at(mounted, at)
    assert not error[:3].any()
    assert error[3:] == pytest.approx(error_at(alone, q), abs=1e3 * ROUNDING)
    assert np.abs(error).max() > 0.1


def test_manipulability_is_of_the_joints_wherever_a_floating_base_is() -> None:
    task = {"type": "manipulability", "frame": {"site": "left_hand"}}
    evaluation = evaluation_of(scene_path("biped", Path()), task)
    model = evaluation.model
    q = random_configuration(model, evaluation.problem.start, np.random.default_rng(0), 0.5)
    moved, base = q.copy(), np.zeros(model.nv)
    base[:6] = (1.0, -2.0, 0.5, 0.3, -1.0, 2.0)
    mujoco.mj_integratePos(model, moved, base, 1.0)
    error = error_at(evaluation, q)
    assert error_at(evaluation, moved) == pytest.approx(error, abs=ROUNDING)
    others = ~np.isin(np.arange(model.nv), left_arm_dofs(evaluation))
    assert not error[others].any()
    assert not evaluation.problem.terms[0].weight[others].any()


def left_arm_dofs(evaluation: Evaluation) -> list[int]:
    model = evaluation.model
    parts = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_yaw", "wrist_pitch")
    names = ["waist_yaw", *(f"left_{part}" for part in parts)]
    return [int(model.joint(name).dofadr[0]) for name in names]


# Below a frame task.


def with_post(folder: Path, position: list[float]) -> str:
    """Write the planar 3R scene with a post of radius 0.1 m in it."""
    spec = mujoco.MjSpec.from_file(scene_path("planar_3r", folder))
    kind = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.worldbody.add_geom(name="post", type=kind, size=[0.1, 0.2, 0.0], pos=[*position, 0.0])
    return written(folder, spec.to_xml())


def run_below_a_frame(
    scene: str, task: dict[str, Any] | None, start: list[float], **others: Any
) -> rmrc.Run:
    tasks: list[dict[str, Any]] = [
        {
            "name": "hand",
            "type": "frame",
            "frame": {"site": "hand"},
            "B": {"position": 100.0, "orientation": 0.0},
            "gain": 50.0,
        }
    ]
    if task is not None:
        tasks.append({"name": "below", "level": 1, **task})
    return rmrc.solve(config(scene, tasks, start=start, **others))


STARTS = {"planar_3r": [0.3, 0.3, 1.9], "panda": [0.5, 0.4, -0.8, -2.4, 0.6, 2.2, 0.9]}


@pytest.mark.parametrize("robot", STARTS)
def test_centering_below_a_frame_brings_the_joints_nearer_to_their_middles(robot: str) -> None:
    task = {"type": "centering", "B": 10.0, "gain": 3.0}
    run = run_below_a_frame(scene_path(robot, Path()), task, STARTS[robot], duration=2.0)
    model = mujoco.MjModel.from_xml_path(scene_path(robot, Path()))
    low, high = model.jnt_range.T
    share = (run.q - 0.5 * (low + high)) / (0.5 * (high - low))
    potential = 0.5 * np.square(share).sum(axis=1)
    assert potential[-1] < 0.9 * potential[0]
    assert np.diff(potential).max() < ROUNDING
    assert run.error["hand"].max() < TRACKING


@pytest.mark.parametrize("robot", STARTS)
def test_manipulability_below_a_frame_rises(robot: str) -> None:
    task = {"type": "manipulability", "frame": {"site": "hand"}, "gain": 3.0}
    scene = scene_path(robot, Path())
    run = run_below_a_frame(scene, task, STARTS[robot], duration=2.0)
    model = mujoco.MjModel.from_xml_path(scene)
    data, found = mujoco.MjData(model), []
    for q in run.q[::50]:
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        found.append(manipulability(data, "hand", "position", 2 if robot == "planar_3r" else 3))
    assert found[-1] > 1.05 * found[0]
    assert np.diff(found).min() > -ROUNDING
    assert run.error["hand"].max() < TRACKING


def test_clearance_keeps_the_elbow_off_a_post_while_the_hand_tracks(tmp_path: Path) -> None:
    scene = with_post(tmp_path, [1.68, 0.8])
    line = {"path": "line", "to": {"position": [1.0, 1.0, 0.0]}, "duration": 2.0}
    links = ["link1", "link2", "link3"]
    task = {"type": "clearance", "pairs": [["post", link] for link in links], "distance": 0.2}
    model = mujoco.MjModel.from_xml_path(scene)
    data, least = mujoco.MjData(model), []
    for below in (None, task):
        run = run_below_a_frame(
            scene,
            below,
            [0.3, 0.9, 0.9],
            duration=2.5,
            targets={"hand": line},
        )
        distances = []
        for q in run.q[::5]:
            data.qpos = q
            mujoco.mj_kinematics(model, data)
            distances += [signed_distance(data, "post", link) for link in links]
        least.append(min(distances))
        assert run.error["hand"].max() < TRACKING
    assert least[0] < -0.005
    assert least[1] > 0.01


@pytest.mark.parametrize("level", [0, 3])
def test_all_three_stay_finite_and_move_only_the_dofs_named(level: int) -> None:
    joints = ["arm_joint2", "arm_joint4", "arm_joint6"]
    shared = {"level": level, "B": 0.5, "gain": "deadbeat"}
    tasks = [
        {"name": "hand", "type": "frame", "frame": {"site": "arm_hand"}},
        {"name": "centre", "type": "centering", **shared},
        {"name": "shape", "type": "manipulability", "frame": {"site": "arm_hand"}, **shared},
        {"name": "clear", "type": "clearance", "pairs": [["floor", "arm_link5"]], **shared},
    ]
    problem = rmrc.compile(config(scene_path("mobile_arm", Path()), tasks, dofs=joints))
    controller = rmrc.Controller(problem)
    still = np.setdiff1d(np.arange(problem.model.nv), problem.dofs)
    for seed in range(100):
        q = np.random.default_rng(seed).uniform(-10.0, 10.0, problem.model.nq)
        q[still] = problem.start[still]
        step = controller.step(q)
        assert np.isfinite(step.v).all()
        assert np.isfinite(controller.engine.evaluation.error).all()
        assert not step.v[still].any()
    assert not any(controller.set_target(name, q=problem.start) for name in ("centre", "clear"))
