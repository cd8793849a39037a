"""Runs with equalities: chains that stay closed, couplings that hold, and what gives way."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import scipy.linalg

import rmrc
from models import config

BACKENDS = ["daqp", "proxqp", "osqp"]
# What the step's curvature opens in 1 ms at 1 rad/s, ½ r (ω dt)², is 1e-7 m; closed again in one.
CLOSED = 1e-6
# What a solution is certified to, in rad/s or m/s.
CERTIFIED = 1e-6
# Of a speed limit, rad/s.
ROUNDING = 1e-9
# What the curvature of a step of 2 ms turns at 2 rad/s, ½ (ω dt)² = 8e-6 rad, over the share
# K dt = 0.02 that a step takes back.
TURNED = 4e-4
# The same, after the 1 s over which it can add up at a gain of 10/s.
HELD = 1e-7

HAND = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "axes": "world"}
LOOP = {"name": "loop", "type": "loop"}


def four_bar_gap(problem: rmrc.Problem, q: np.ndarray) -> float:
    """Return the distance between the two ends that the chain's pin joins, m."""
    data = mujoco.MjData(problem.model)
    data.qpos = q
    mujoco.mj_kinematics(problem.model, data)
    return float(np.linalg.norm(data.site("coupler_end").xpos - data.site("rocker_end").xpos))


def compiled(repository: Path, scene: str, tasks: list[dict[str, Any]], **others: Any):
    return rmrc.compile(config(f"scenes/{scene}.xml", tasks, **others).rooted(repository))


@pytest.mark.parametrize(("backend", "duration"), [("daqp", 7.0), ("proxqp", 1.0), ("osqp", 1.0)])
def test_the_four_bar_turns_and_stays_closed(
    repository: Path, backend: str, duration: float
) -> None:
    overrides = {"solver.backend": backend, "duration": duration}
    given = rmrc.load(repository / "configs" / "four_bar.yaml", overrides=overrides)
    problem = rmrc.compile(given)
    run = rmrc.solve(problem)
    crank = run.q[:, problem.model.joint("crank").qposadr[0]]
    # At 1 rad/s, of which λ² = 1e-4 takes its share: more than once round in 7 s.
    assert crank[-1] - crank[0] == pytest.approx(duration, rel=1e-3)
    assert max(four_bar_gap(problem, q) for q in run.q[::7]) < CLOSED
    assert run.error["chain"].max() < CLOSED
    assert set(run.summary["status"]) == {"OK"}


@pytest.mark.parametrize("engine", ["python", "native"])
def test_a_chain_stays_closed_while_a_frozen_joint_brakes(repository: Path, engine: Any) -> None:
    problem = compiled(
        repository,
        "four_bar",
        [{**LOOP, "gain": "deadbeat"}, {"type": "freeze", "name": "still", "joints": ["rocker"]}],
        limits={"acceleration": {"default": 50.0, "rocker": 3.0}},
        start="home",
        dt=0.001,
    )
    data = mujoco.MjData(problem.model)
    data.qpos = problem.start
    mujoco.mj_forward(problem.model, data)
    pinned = data.efc_J.reshape(-1, problem.model.nv)[: data.ne]
    moving = scipy.linalg.null_space(pinned, rcond=1e-6)[:, 0]
    controller = rmrc.Controller(problem, engine)
    controller.reset(problem.start, v=0.1 * moving / moving[2])  # the rocker turns at 0.1 rad/s
    steps = [controller.step() for _ in range(50)]
    assert not any(step.flags & {rmrc.Status.RELAXED} for step in steps)
    assert max(four_bar_gap(problem, step.q) for step in steps) < CLOSED
    assert 0.0 < steps[20].v[2] < 0.1
    assert abs(steps[-1].v[2]) < CERTIFIED


def test_a_chain_follows_a_path_with_its_coupler(repository: Path) -> None:
    point = {"name": "point", "type": "frame", "frame": {"site": "coupler_point"}}
    B = {"position": 1.0, "orientation": 0.0}
    # The only way that the chain leaves: the curve that the crank's own turn draws.
    turned = compiled(
        repository,
        "four_bar",
        [{**LOOP, "gain": "deadbeat"}, {"name": "v", "type": "velocity", "target": {"crank": 1.0}}],
        duration=1.0,
    )
    drawn = rmrc.solve(turned)
    problem = compiled(
        repository, "four_bar", [{**point, "B": B, "gain": 50.0}, {**LOOP, "gain": "deadbeat"}]
    )
    controller = rmrc.Controller(problem)
    data = mujoco.MjData(problem.model)
    far = gap = 0.0
    for q in drawn.q:
        data.qpos = q
        mujoco.mj_kinematics(problem.model, data)
        controller.set_target("point", position=data.site("coupler_point").xpos)
        step = controller.step()
        far, gap = max(far, step.error["point"][0]), max(gap, four_bar_gap(problem, step.q))
    assert gap < 4 * CLOSED  # at 2 ms
    assert far < 0.01  # without feed-forward it trails by the speed over the gain, 0.4 / 50 m


@pytest.mark.parametrize("hard", [True, False])
def test_an_open_chain_closes(repository: Path, hard: bool) -> None:
    start = {"crank": 1.4, "coupler": -0.7, "rocker": 2.4}
    problem = compiled(repository, "four_bar", [{**LOOP, "hard": hard, "gain": 20.0}], start=start)
    controller = rmrc.Controller(problem)
    gaps = [four_bar_gap(problem, problem.start)]
    gaps.extend(four_bar_gap(problem, controller.step().q) for _ in range(500))
    assert gaps[0] > 0.05
    assert (np.diff(gaps) < CLOSED).all()
    assert gaps[-1] < CLOSED


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_hard_task_comes_before_every_cost(repository: Path, backend: str) -> None:
    point = [0.4, 0.3, 0.5]
    keep = {**HAND, "B": [0, 0, 1, 0, 0, 0], "hard": True}
    pull = {**HAND, "name": "pull", "B": {"position": 1e4, "orientation": 0.0}}
    problem = compiled(repository, "panda", [keep, pull], start="home", solver={"backend": backend})
    height = problem.forward(problem.start)["hand"][2, 3]
    controller = rmrc.Controller(problem)
    controller.set_target("pull", position=point)
    steps = [controller.step() for _ in range(1000)]
    assert not any(step.status == rmrc.Status.RELAXED for step in steps)
    reached = problem.forward(steps[-1].q)["hand"][:3, 3]
    assert abs(reached[2] - height) < HELD
    # What the cost asks for along z is given up, and nothing else is.
    np.testing.assert_allclose(reached[:2], point[:2], atol=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_axis_may_be_hard(repository: Path, backend: str) -> None:
    gaze = {"name": "gaze", "type": "axis_align", "frame": {"site": "hand"}, "hard": True}
    pull = {**HAND, "B": {"position": 1.0, "orientation": 0.0}}
    solver = {"backend": backend}
    problem = compiled(repository, "panda", [gaze, pull], start="home", solver=solver)
    controller = rmrc.Controller(problem)
    controller.set_target("hand", position=[0.4, 0.3, 0.4])
    steps = [controller.step() for _ in range(1000)]
    assert max(step.error["gaze"][0] for step in steps) < TURNED
    assert {step.status for step in steps} <= {rmrc.Status.OK, rmrc.Status.LIMITED}
    assert steps[-1].error["hand"][0] < 2e-3


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("bend", [0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-2])
def test_a_hard_task_at_a_singularity_stays_in_the_box(
    repository: Path, backend: str, bend: float
) -> None:
    keep = {**HAND, "B": {"position": 1.0, "orientation": 0.0}, "hard": True}
    problem = compiled(
        repository,
        "planar_2r",
        [keep],
        start=[0.3, bend],
        limits={"velocity": {"default": 2.0}, "acceleration": {"default": 50.0}},
        solver={"backend": backend},
    )
    stretched = problem.forward(problem.start)["hand"][:3, 3]
    for reach in (0.5, 0.99, 1.0, 1.5):
        controller = rmrc.Controller(problem)
        controller.set_target("hand", position=reach * stretched)
        steps = [controller.step() for _ in range(50)]
        v = np.array([step.v for step in steps])
        assert np.abs(v).max() <= 2.0
        assert np.abs(np.diff(v, axis=0)).max() <= 50.0 * problem.dt + ROUNDING
        assert max(step.solution.kkt.primal for step in steps) < CERTIFIED
        assert max(step.status for step in steps) <= rmrc.Status.STUCK


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_the_box_forbids_is_relaxed_and_said(repository: Path, backend: str) -> None:
    asked = {"name": "ask", "type": "velocity", "target": {"joint1": 9.0, "joint3": 0.5}}
    problem = compiled(
        repository,
        "panda",
        [{**asked, "hard": True}],
        start="home",
        limits={"velocity": {"default": 2.0}},
        solver={"backend": backend},
    )
    step = rmrc.Controller(problem).step()
    assert step.status == rmrc.Status.RELAXED
    np.testing.assert_allclose(step.v, [2.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0], atol=CERTIFIED)


def test_what_contradicts_itself_is_relaxed_to_the_middle(repository: Path) -> None:
    tasks = [
        {"name": name, "type": "velocity", "target": {"joint1": rate}, "hard": True}
        for name, rate in (("slow", 0.2), ("fast", 0.6))
    ]
    problem = compiled(repository, "panda", tasks, start="home")
    step = rmrc.Controller(problem).step()
    assert step.status == rmrc.Status.RELAXED
    np.testing.assert_allclose(step.v, [0.4, 0, 0, 0, 0, 0, 0], atol=CERTIFIED)


def test_a_coupling_holds_and_brings_the_joints_back(repository: Path) -> None:
    pair = {
        "name": "pair",
        "type": "coupling",
        "coefficients": {"joint2": 1.0, "joint4": 0.5},
        "offset": -1.0,
    }
    pull = {**HAND, "B": {"position": 1.0, "orientation": 0.0}}
    problem = compiled(repository, "panda", [pair, pull], start="home")
    controller = rmrc.Controller(problem)
    controller.set_target("hand", position=[0.45, 0.2, 0.5])
    sums = []
    for _ in range(1000):
        q = controller.step().q
        sums.append(abs(q[1] + 0.5 * q[3] + 1.0))
    assert sums[0] > 0.01
    assert (np.diff(sums) < HELD).all()
    assert sums[-1] < HELD


def test_hard_tasks_stand_above_strict_levels(repository: Path) -> None:
    level = HAND | {"B": {"position": 1.0, "orientation": 0.0}}
    posture = {"name": "posture", "type": "posture", "level": 1}
    pair = {"name": "pair", "type": "coupling", "coefficients": {"joint1": 1.0, "joint7": -1.0}}
    problem = compiled(
        repository,
        "panda",
        [level, posture, pair],
        start={"joint7": 0.0},
        priority="strict",
    )
    controller = rmrc.Controller(problem)
    controller.set_target("hand", position=problem.forward(problem.start)["hand"][:3, 3] + 0.1)
    steps = [controller.step() for _ in range(1000)]
    assert max(abs(step.v[0] - step.v[6]) for step in steps) < CERTIFIED
    assert {step.status for step in steps} <= {rmrc.Status.OK, rmrc.Status.LIMITED}
    assert steps[-1].error["hand"][0] < 1e-3
    assert abs(steps[-1].q[0] - steps[-1].q[6]) < HELD


@pytest.mark.usefixtures("menagerie")
def test_the_shadow_hands_fingers_share_their_tendons(repository: Path) -> None:
    given = rmrc.load(repository / "configs" / "menagerie_shadow.yaml")
    problem = rmrc.compile(given)
    run = rmrc.solve(problem)
    model, data = problem.model, mujoco.MjData(problem.model)
    assert run.summary["converged"]
    bend = model.joint("rh_FFJ2").qposadr[0], model.joint("rh_FFJ1").qposadr[0]
    assert run.q[-1, bend[0]] > 0.4
    for finger in ("FF", "MF", "RF", "LF"):
        middle, distal = (model.joint(f"rh_{finger}J{k}").qposadr[0] for k in (2, 1))
        np.testing.assert_allclose(run.q[:, middle], run.q[:, distal], atol=HELD)
    # What the finger's one actuator is commanded with is the length of its tendon.
    data.qpos = run.q[-1]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    assert data.tendon("rh_FFJ0").length[0] == pytest.approx(2 * run.q[-1, bend[0]], abs=HELD)


@pytest.mark.usefixtures("menagerie")
@pytest.mark.parametrize(
    ("scene", "joints", "rate"),
    [
        ("franka_emika_panda/panda", ["finger_joint1", "finger_joint2"], -0.02),
        ("aloha/aloha", ["left/left_finger", "left/right_finger"], 0.02),
        ("ufactory_xarm7/xarm7", ["left_driver_joint", "right_driver_joint"], 0.02),
    ],
)
def test_real_grippers_move_as_their_equalities_say(
    scene: str, joints: list[str], rate: float
) -> None:
    task = {"name": "close", "type": "velocity", "target": {joints[0]: rate}}
    # ALOHA without a keyframe starts outside the ranges of its fingers.
    start = dict.fromkeys(joints, 0.01) if scene.startswith("aloha") else None
    tasks = [{**LOOP, "gain": "deadbeat"}, task]
    problem = rmrc.compile(config(f"menagerie:{scene}", tasks, start=start))
    controller = rmrc.Controller(problem)
    before = problem.start.copy()
    step = [controller.step() for _ in range(100)][-1]
    assert step.error["loop"].max() < CLOSED
    moved = [
        step.q[problem.model.joint(name).qposadr[0]] - before[problem.model.joint(name).qposadr[0]]
        for name in joints
    ]
    assert moved[0] == pytest.approx(moved[1], abs=CLOSED)
    # 100 steps of 2 ms; the damping λ² = 1e-4 counts for both fingers beside the task's weight 1.
    assert moved[0] == pytest.approx(0.2 * rate, rel=1e-3)


COUPLED = 12
# Of what a coupling holds, rad: the rounding of 13 coordinates.
COUPLING_ROUNDING = 1e-12


def test_a_loop_of_many_rows_holds_them_all(tmp_path: Path) -> None:
    """12 joints that turn as the first: more rows than a pose has."""
    links = "".join(
        f'<body name="b{k}" pos="{k} 0 0"><joint name="j{k}" axis="0 1 0"/><geom size=".1"/>'
        f'<site name="s{k}" pos="0 0 .3"/></body>'
        for k in range(COUPLED + 1)
    )
    equal = "".join(f'<joint joint1="j{k}" joint2="j0"/>' for k in range(1, COUPLED + 1))
    scene = tmp_path / "coupled.xml"
    scene.write_text(f"<mujoco><worldbody>{links}</worldbody><equality>{equal}</equality></mujoco>")
    hand = HAND | {"frame": {"site": "s0"}, "B": {"position": 1.0, "orientation": 0.0}}
    given = config(str(scene), [hand, LOOP], dt=0.002)
    runs = {}
    for engine in ("native", "python"):
        problem = rmrc.compile(given)
        controller = rmrc.Controller(problem, engine=engine)
        controller.set_target("hand", position=[0.1, 0.0, 0.28284])
        step = controller.step()
        for _ in range(300):
            step = controller.step()
            assert np.abs(step.q[1:] - step.q[0]).max() < COUPLING_ROUNDING
        runs[engine] = step.q
        explained = {task.name: task for task in step.explain().tasks}
        assert explained["loop"].units == ("rad",)
        assert len(explained["loop"].asked) == 1
    assert np.abs(runs["native"] - runs["python"]).max() < CLOSED
    reached = rmrc.compile(given).forward(runs["native"])["hand"][:3, 3]
    assert np.linalg.norm(reached - [0.1, 0.0, 0.28284]) < 1e-3


@pytest.mark.parametrize("engine", ["native", "python"])
def test_a_hard_task_that_means_no_direction_holds_nothing(repository: Path, engine: Any) -> None:
    nothing = HAND | {"name": "nothing", "hard": True, "B": 0.0}
    moving = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    problem = compiled(repository, "panda", [nothing, moving], start="home")
    controller = rmrc.Controller(problem, engine=engine)
    controller.set_target("hand", position=[0.5, 0.2, 0.4])
    step = controller.step()
    assert step.status < rmrc.Status.MAX_ITER
    assert step.v.any()
