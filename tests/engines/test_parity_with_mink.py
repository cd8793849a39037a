"""The step equals mink's where both are defined: K = gain/dt, B = cost², λ² = damping."""

from dataclasses import dataclass
from typing import Any

import mink
import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc.limits.joints import HINGE_SPEED

DT = 0.002
GAIN = 0.02  # mink's, per step
DAMPING = 1e-4
STEPS = 500
PARITY = 1e-8  # rad/s; both solvers are asked for more than that
SOLVER: dict[str, Any] = {
    "primal_tol": 1e-13,
    "dual_tol": 1e-13,
}  # of Δq, 500 times smaller than v at this dt
TURNED = 0.02
"""By how much a target's quaternion is off: below 1e-3 rad mink's Jacobian of a pose loses digits,
and is the identity below 1e-8 rad."""

SMALL = 1e-6
"""An error in m and rad at which the curvature, dt K ‖B e‖ times a few levers, is about 1e-3 of λ²,
and so moves rates of 1e-5 rad/s by less than `PARITY`."""

# Targets far from the start, by type of task.
# Of points, m, and directions: within a right angle, beyond which our error is longer than mink's.
ASIDE = np.array([0.3, 0.4, -0.2])


@dataclass(frozen=True)
class Case:
    """A robot, its frames, and whether it has a centre of mass to control."""

    scene: str
    frames: tuple[tuple[str, str], ...]
    com: bool = False
    relative: bool = False
    start: dict[str, float] | None = None


# The G1 stands with six finger joints exactly on a limit; here they start inside.
FINGERS = {
    "left_two_joint": 0.5,
    "left_four_joint": -0.5,
    "left_six_joint": -0.5,
    "right_two_joint": -0.5,
    "right_four_joint": 0.5,
    "right_six_joint": 0.5,
}
PLAIN = {
    "panda": Case("panda", (("site", "hand"),)),
    "biped": Case(
        "biped",
        (("site", "left_foot"), ("site", "right_foot"), ("site", "left_hand"), ("body", "torso")),
        com=True,
        relative=True,
    ),
}
MENAGERIE = {
    "real panda": Case("franka_emika_panda/panda_nohand", (("site", "attachment_site"),)),
    "real g1": Case(
        "unitree_g1/g1",
        (("site", "left_foot"), ("site", "right_foot"), ("site", "left_palm"), ("site", "head")),
        com=True,
        relative=True,
        start=FINGERS,
    ),
    "real ur5e": Case("universal_robots_ur5e/ur5e", (("site", "attachment_site"),)),
}


@pytest.fixture(params=[*PLAIN, *MENAGERIE])
def case(request: pytest.FixtureRequest) -> Case:
    if request.param in MENAGERIE:
        request.getfixturevalue("menagerie")
    return {**PLAIN, **MENAGERIE}[request.param]


def scene_of(case: Case) -> str:
    own = REPOSITORY / "scenes" / f"{case.scene}.xml"
    return str(own) if own.is_file() else f"menagerie:{case.scene}"


def our_tasks(case: Case) -> list[dict[str, Any]]:
    gain = GAIN / DT
    tasks: list[dict[str, Any]] = [
        {
            "name": name,
            "type": "frame",
            "frame": {kind: name},
            "B": [1.0, 2.0, 3.0, 0.5, 0.25, 0.75],
            "gain": gain,
        }
        for kind, name in case.frames
    ]
    if case.com:
        tasks.append({"name": "com", "type": "com", "B": [4.0, 5.0, 6.0], "gain": gain})
    if case.relative:
        (kind, name), (root_kind, root) = case.frames[2], case.frames[3]
        tasks.append(
            {
                "name": "relative",
                "type": "relative_frame",
                "frame": {kind: name},
                "root": {root_kind: root},
                "B": 0.3,
                "gain": gain,
            }
        )
    kind, name = case.frames[0]
    frame = {kind: name}
    tasks += [
        {"name": "gaze", "type": "look_at", "frame": frame, "B": 0.2, "gain": gain},
        {"name": "align", "type": "axis_align", "frame": frame, "B": 0.1, "gain": gain},
        {"name": "posture", "type": "posture", "B": 0.01, "gain": gain},
        {"name": "energy", "type": "kinetic_energy", "B": 1e-3},
    ]
    return tasks


def mink_tasks(case: Case, controller: rmrc.Controller) -> dict[str, mink.tasks.BaseTask]:
    model = controller.problem.model
    root = np.sqrt
    tasks: dict[str, mink.tasks.BaseTask] = {
        name: mink.FrameTask(name, kind, root([1, 2, 3]), root([0.5, 0.25, 0.75]), gain=GAIN)
        for kind, name in case.frames
    }
    if case.com:
        tasks["com"] = mink.ComTask(root([4.0, 5.0, 6.0]), gain=GAIN)
    if case.relative:
        (kind, name), (root_kind, root_name) = case.frames[2], case.frames[3]
        tasks["relative"] = mink.RelativeFrameTask(
            name, kind, root_name, root_kind, root(0.3), root(0.3), gain=GAIN
        )
    kind, name = case.frames[0]
    tasks["gaze"] = mink.LookAtTask(name, kind, cost=root(0.2), gain=GAIN)
    tasks["align"] = mink.AxisAlignTask(name, kind, cost=root(0.1), gain=GAIN)
    tasks["posture"] = mink.PostureTask(model, cost=root(0.01), gain=GAIN)
    # The one task of mink's that divides by dt²; the others' residuals are in Δq.
    energy = mink.KineticEnergyRegularizationTask(cost=1e-3 * DT**2)
    energy.set_dt(DT)
    tasks["energy"] = energy
    return tasks


def aim(name: str, task: Any, target: np.ndarray) -> None:
    """Give a mink task the target that ours has."""
    if isinstance(task, (mink.FrameTask, mink.RelativeFrameTask)):
        task.set_target(mink.SE3(target))
    elif not isinstance(task, mink.KineticEnergyRegularizationTask):
        task.set_target(target)


@pytest.mark.parametrize("far", [False, True], ids=["limits inactive", "limits active"])
def test_the_step_is_minks(case: Case, far: bool) -> None:
    apart, limited, _ = compare_steps(case, far, 1.5 if far else 0.01, TURNED, "off")
    assert apart < PARITY
    assert (limited > 0) == far


def test_with_the_curvature_it_is_minks_where_errors_are_small(case: Case) -> None:
    apart, _, fastest = compare_steps(case, False, SMALL, SMALL, "on")
    assert apart < PARITY
    assert fastest > 100.0 * PARITY


def compare_steps(
    case: Case, far: bool, reach: float, turn: float, curvature: str
) -> tuple[float, int, float]:
    """Return the largest difference of v, the number of limited steps, and the largest rate."""
    tasks = our_tasks(case)
    controller = rmrc.Controller(
        rmrc.compile(
            config(
                scene_of(case),
                tasks,
                start=case.start,
                dt=DT,
                damping={"lambda": DAMPING**0.5, "curvature": curvature},
                soft_ratio=1.0,
            )
        )
    )
    problem, model = controller.problem, controller.problem.model
    theirs = mink_tasks(case, controller)
    rng = np.random.default_rng(1)
    for name, term in problem.term.items():
        if term.target_kind == "pose":
            turned = term.target[:4] + turn * rng.normal(size=4)
            controller.set_target(name, term.target[4:] + rng.uniform(-reach, reach, 3), turned)
        elif far and term.target_kind == "point" and term.type == "look_at":
            controller.set_target(name, term.target + ASIDE)
        elif far and term.target_kind == "direction":
            controller.set_target(name, direction=term.target + ASIDE)
    targets = controller.engine.evaluation.target
    for name, task in theirs.items():
        aim(name, task, targets[name])
    configuration = mink.Configuration(model, problem.start)
    hinges = [
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    ]
    limits = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, dict.fromkeys(hinges, HINGE_SPEED)),
    ]
    limited, worst, fastest = 0, 0.0, 0.0
    for _ in range(STEPS):
        step = controller.step()
        v = mink.solve_ik(
            configuration, list(theirs.values()), DT, "daqp", DAMPING, limits=limits, **SOLVER
        )
        worst = max(worst, float(np.abs(step.v - v).max()))
        fastest = max(fastest, float(np.abs(v).max()))
        limited += rmrc.Status.LIMITED in step.flags
        configuration.update(step.q)
    return worst, limited, fastest


def test_a_mink_task_and_limit_added_from_python_count_as_in_mink() -> None:
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "gain": GAIN / DT}
    posture = mink.PostureTask(mujoco.MjModel.from_xml_path(scene), cost=0.3, gain=GAIN)
    posture.set_target(mujoco.MjModel.from_xml_path(scene).key_qpos[0])
    limit = mink.VelocityLimit(mujoco.MjModel.from_xml_path(scene), {"joint2": 0.05})
    made = rmrc.compile(
        config(scene, [hand], dt=DT, damping={"lambda": DAMPING**0.5, "curvature": "off"}),
        mink_tasks=[posture],
        mink_limits=[limit],
    )
    controller = rmrc.Controller(made)
    start = made.term["hand"].target
    controller.set_target("hand", start[4:] + [0.1, 0.1, -0.2], start[:4] + [0, 0, TURNED, 0])
    frame = mink.FrameTask("hand", "site", 1.0, 1.0, gain=GAIN)
    aim("hand", frame, controller.engine.evaluation.target["hand"])
    configuration = mink.Configuration(made.model, made.start)
    joints = {f"joint{i}": HINGE_SPEED for i in range(1, 8)}
    limits = [
        mink.ConfigurationLimit(made.model),
        mink.VelocityLimit(made.model, joints),
        limit,
    ]
    for _ in range(50):
        step = controller.step()
        v = mink.solve_ik(
            configuration, [frame, posture], DT, "daqp", DAMPING, limits=limits, **SOLVER
        )
        assert np.abs(step.v - v).max() < PARITY
        configuration.update(step.q)
