"""The whole program against an independent assembly, its invariance to units, and the clamp."""

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config, random_configuration

BIPED = str(REPOSITORY / "scenes" / "biped.xml")
PANDA = str(REPOSITORY / "scenes" / "panda.xml")
# Two ways of adding the same few hundred products.
ROUNDING = 1e-10
# Backends are asked for 1e-12 in a program whose weights are at most 1, of condition up to 1e6.
SAME_OPTIMUM = 1e-6


def test_the_program_is_the_designs_term_by_term() -> None:
    rng = np.random.default_rng(5)
    nv = 31
    root = rng.normal(size=(nv, nv)) / nv
    full = (root @ root.T).tolist()
    tasks = [
        {"name": "hand", "type": "frame", "frame": {"site": "left_hand"}, "B": [1, 2, 3, 4, 5, 6]},
        {"name": "com", "type": "com", "B": 7.0, "gain": 3.0},
        {"name": "low", "type": "frame", "frame": {"site": "head"}, "level": 2, "B": 5.0},
        {"name": "posture", "type": "posture", "B": full, "gain": 2.0},
        {"name": "rest", "type": "posture", "B": 0.3, "gain": 4.0, "level": 1},
        {"name": "spin", "type": "velocity", "target": {"waist_yaw": 0.7}, "B": 0.4},
        {"name": "smooth", "type": "smooth", "B": 0.2},
        {"name": "energy", "type": "kinetic_energy", "B": 0.01, "level": 1},
    ]
    dofs = ["waist_yaw", "left_elbow", "left_shoulder_pitch", "right_knee", "root"]
    ratio, damping = 0.1, 0.2
    made = config(
        BIPED,
        tasks,
        dofs=dofs,
        soft_ratio=ratio,
        damping={"lambda": damping, "curvature": "off"},
        metric="inertia",
        limits={"velocity": "off", "position": "off"},
    )
    controller = rmrc.Controller(rmrc.compile(made))
    problem, model = controller.problem, controller.problem.model
    controller.set_target("hand", problem.term["hand"].target[4:] + 0.05)
    q = random_configuration(model, problem.start, rng, 0.2)
    previous = controller.step(q).v
    step = controller.step(q)

    evaluation, data = controller.engine.evaluation, controller.engine.evaluation.data
    inertia = np.zeros((nv, nv))
    mujoco.mj_makeM(model, data)
    mujoco.mj_fullM(model, data, inertia)
    hessian = (1.0 + 0.01 * ratio) * inertia + damping**2 * np.eye(nv)
    gradient = np.zeros(nv)
    away = np.zeros(nv)
    mujoco.mj_differentiatePos(model, away, 1.0, q, problem.start)
    actuated = np.arange(nv) >= 6
    for name, weight, rate in (
        ("posture", np.array(full) * np.outer(actuated, actuated), 2.0 * away),
        ("rest", ratio * 0.3 * np.diag(actuated * 1.0), 4.0 * away),
        ("spin", 0.4 * np.diag(np.arange(nv) == 6), 0.7 * (np.arange(nv) == 6)),
        ("smooth", 0.2 * np.eye(nv), previous),
    ):
        hessian += weight
        gradient += weight @ rate
        assert name in problem.term
    for name, weight, gain in (
        ("hand", np.diag([1.0, 2, 3, 4, 5, 6]), 10.0),
        ("com", 7.0 * np.eye(3), 3.0),
        ("low", ratio**2 * 5.0 * np.eye(6), 10.0),
    ):
        rows = evaluation.rows_of([problem.term[name]])
        jacobian, error = evaluation.jacobian[rows], evaluation.error[rows]
        hessian += jacobian.T @ weight @ jacobian
        gradient += jacobian.T @ weight @ (gain * error)
    chosen = problem.dofs
    assert chosen.size == 10
    expected = np.linalg.solve(hessian[np.ix_(chosen, chosen)], gradient[chosen])
    assert step.v[chosen] == pytest.approx(expected, abs=ROUNDING * np.abs(expected).max())


@pytest.mark.parametrize("backend", ["daqp", "proxqp", "osqp"])
@pytest.mark.parametrize("scale", [1e-10, 1e-6, 1e4, 1e8])
def test_the_unit_of_the_cost_changes_nothing(backend: str, scale: float) -> None:
    def steps(unit: float) -> tuple[np.ndarray, list]:
        tasks = [
            {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "B": unit, "gain": 5.0},
            {"name": "posture", "type": "posture", "B": 1e-3 * unit},
        ]
        made = config(
            PANDA,
            tasks,
            damping={"lambda": 0.01 * unit**0.5},
            limits={"velocity": {"default": 0.5}},
            solver={"backend": backend},
        )
        controller = rmrc.Controller(rmrc.compile(made))
        controller.set_target("hand", [0.45, 0.3, 0.5])
        taken = [controller.step() for _ in range(100)]
        return np.array([step.v for step in taken]), [step.status for step in taken]

    (v, statuses), (scaled, others) = steps(1.0), steps(scale)
    assert np.abs(v - scaled).max() < SAME_OPTIMUM
    assert statuses == others


def test_a_clamp_bounds_the_rate_and_leaves_the_error_true() -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "clamp": {"position": 0.01}}
    com = {"name": "com", "type": "com", "clamp": 1e-3}
    controller = rmrc.Controller(rmrc.compile(config(PANDA, [hand, com])))
    start = controller.problem.term["hand"].target[4:]
    controller.set_target("hand", start + [0.3, 0.0, 0.4])
    controller.set_target("com", [5.0, 5.0, 5.0])
    step = controller.step()
    assert step.error["hand"][0] == pytest.approx(0.5, abs=1e-12)
    assert step.error["com"][0] > 5.0
    rate = controller.engine.assembly.rate
    assert np.linalg.norm(rate[:3]) == pytest.approx(10.0 * 0.01)
    com_rows = controller.engine.evaluation.rows_of([controller.problem.term["com"]])
    assert np.linalg.norm(rate[com_rows]) == pytest.approx(10.0 * 1e-3)


def test_com_is_that_of_the_robots_not_of_the_furniture() -> None:
    spec = mujoco.MjSpec()
    for side in (-1.0, 1.0):
        body = spec.worldbody.add_body(name=f"arm{side:+.0f}", pos=[0, side, 0])
        body.add_joint(name=f"joint{side:+.0f}", axis=[0, 0, 1])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1] * 3, pos=[0.5, 0, 0], mass=1.0)
    table = spec.worldbody.add_body(name="table", pos=[5, 0, 0])
    table.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1] * 3, mass=8000.0)
    from rmrc.tasks import ComTask

    model = spec.compile()
    term = ComTask(name="com").compile(model, model.qpos0)
    assert term.target == pytest.approx([0.5, 0.0, 0.0])


def test_rows_that_contradict_the_box_get_slack_and_say_so() -> None:
    import mink

    model = mujoco.MjModel.from_xml_path(PANDA)
    limit = mink.VelocityLimit(model, {"joint1": 0.05})
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    controller = rmrc.Controller(rmrc.compile(config(PANDA, [hand]), mink_limits=[limit]))
    q = controller.problem.start.copy()
    q[0] = 3.2
    step = controller.step(q)
    assert rmrc.Status.RELAXED in step.flags
    assert step.v[0] == pytest.approx(-np.pi)  # what the box asks for, and no more
    assert np.abs(step.v).max() <= np.pi
    assert rmrc.Status.RELAXED not in controller.step(controller.problem.start).flags
