"""What `Controller` promises at run time: finite, inside the box, a status, never an exception."""

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc import Status
from rmrc.control import engines
from rmrc.limits.box import RANGE_ROUNDING

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
BIPED = str(REPOSITORY / "scenes" / "biped.xml")
HAND = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
# The optimum of a program may sit this far from its bound: rounding of q ± v dt.
ROUNDING = 1e-12


@pytest.fixture(params=["python", "native"], autouse=True)
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold both engines to all of it."""
    if request.param == "native":
        pytest.importorskip(
            "rmrc._native", reason="the native extension is not built", exc_type=ImportError
        )
    else:
        monkeypatch.setattr(engines, "_reason", lambda problem: "the Python engine is meant")


def panda(*more, tasks=(), **others) -> rmrc.Controller:
    return rmrc.Controller(rmrc.compile(config(PANDA, [HAND, *tasks], **others)))


def ahead(controller: rmrc.Controller, *offset: float) -> np.ndarray:
    return controller.problem.term["hand"].target[4:] + offset


def test_a_step_moves_towards_the_target_and_says_ok() -> None:
    controller = panda()
    assert controller.set_target("hand", ahead(controller, 0.05, 0.0, -0.05))
    step = controller.step()
    assert step.status is Status.OK
    assert step.flags == {Status.OK}
    assert step.error["hand"] == pytest.approx([np.hypot(0.05, 0.05), 0.0], abs=1e-12)
    for _ in range(1000):
        step = controller.step()
    assert step.error["hand"][0] < 1e-3
    assert list(step.error) == ["hand"]


def test_v_is_the_rate_from_q_to_the_configuration_returned() -> None:
    controller = rmrc.Controller(
        rmrc.compile(config(BIPED, [{**HAND, "frame": {"site": "left_hand"}}]))
    )
    controller.set_target("hand", controller.problem.term["hand"].target[4:] + 0.1)
    q = controller.problem.start
    step = controller.step(q, dt=0.01)
    v = np.empty(controller.problem.model.nv)
    mujoco.mj_differentiatePos(controller.problem.model, v, 0.01, q, step.q)
    assert np.abs(v - step.v).max() < 1e-9


BAD_CONFIGURATIONS = [
    np.full(7, np.nan),
    np.array([0, 0, 0, np.inf, 0, 0, 0.0]),
    np.zeros(6),
    np.zeros((7, 1)),
    np.zeros(7, dtype=complex) + 1j,
    "straight",
    ["a"] * 7,
    [[1, 2], [3]],
    object(),
    np.full(7, 1e200),
]


@pytest.mark.parametrize("bad", BAD_CONFIGURATIONS, ids=range(len(BAD_CONFIGURATIONS)))
def test_a_bad_configuration_brakes_and_leaves_the_controller_as_it_was(bad) -> None:
    controller, twin = panda(), panda()
    for each in (controller, twin):
        each.set_target("hand", ahead(each, 0.1, 0.0, 0.0))
        each.step()
    step = controller.step(bad)
    assert step.status is Status.INVALID_INPUT
    assert np.array_equal(step.v, np.zeros(7))
    assert np.isfinite(step.q).all()
    assert np.array_equal(controller.step().v, twin.step().v)


@pytest.mark.parametrize("dt", [0.0, -0.002, np.nan, np.inf, "2 ms", 1e-300, 1e300, 10**400])
def test_a_bad_dt_brakes(dt) -> None:
    controller = panda()
    controller.set_target("hand", ahead(controller, 0.1, 0.0, 0.0))
    assert controller.step(dt=dt).status is Status.INVALID_INPUT
    assert controller.step().status is not Status.INVALID_INPUT


def test_braking_keeps_the_acceleration_limit() -> None:
    controller = panda(limits={"acceleration": {"default": 10.0}})
    controller.set_target("hand", ahead(controller, 0.2, 0.2, -0.2))
    last = controller.step()
    for _ in range(30):
        last = controller.step()
    assert np.abs(last.v).max() > 0.1
    while np.abs(last.v).max() > 0:
        step = controller.step(np.full(7, np.nan))
        assert step.status is Status.INVALID_INPUT
        assert np.abs(step.v - last.v).max() <= 10.0 * controller.problem.dt + ROUNDING
        assert np.abs(step.v).max() < np.abs(last.v).max()
        last = step


def test_the_measured_velocity_is_that_between_the_last_two_measurements() -> None:
    # One that is given with the second of them does not let the first one count for longer.
    controller = panda(limits={"acceleration": {"default": 10.0}}, previous="measured")
    # A joint that the last command slows down goes on from there.
    change = 10.0 * controller.problem.dt
    first, rate = controller.problem.start, np.linspace(-0.3, 0.3, 7)
    second, third = (first + k * controller.problem.dt * rate for k in (1, 2))
    for given in (None, 2.0 * rate):
        controller.reset()
        controller.step(first)
        step = controller.step(second, v=given)
        assert np.abs(step.v - (rate if given is None else given)).max() <= change + ROUNDING
        slowed = np.where(np.abs(step.v) < np.abs(rate), step.v, rate)
        assert np.abs(controller.step(third).v - slowed).max() <= change + ROUNDING


BAD_TARGETS = [
    {"position": [np.nan, 0, 0]},
    {"position": [0, 0]},
    {"position": 0.5},
    {"position": "there"},
    {"quaternion": [0, 0, 0, 0]},
    {"quaternion": [1e-20, 0, 0, 0]},
    {"quaternion": [np.inf, 0, 0, 0]},
    {"quaternion": [1, 0, 0]},
    {"velocity": [0, 0, 0]},
    {"velocity": [np.nan] * 6},
    {"direction": [0, 0, 1]},
    {"q": np.zeros(7)},
]


@pytest.mark.parametrize("bad", BAD_TARGETS, ids=range(len(BAD_TARGETS)))
def test_a_bad_target_is_refused_and_the_last_good_one_stays(bad) -> None:
    controller, twin = panda(), panda()
    for each in (controller, twin):
        assert each.set_target("hand", ahead(each, 0.1, 0.0, 0.0), [0, 2, 0, 0])
    assert not controller.set_target("hand", **bad)
    step = controller.step()
    assert Status.INVALID_INPUT in step.flags
    assert np.array_equal(step.v, twin.step().v)
    assert Status.INVALID_INPUT not in controller.step().flags


def test_a_quaternion_of_any_norm_and_either_sign_is_the_same_target() -> None:
    steps = []
    for quaternion in ([0.0, 0.6, 0.8, 0.0], [0.0, 1.2, 1.6, 0.0], [0.0, -0.6, -0.8, 0.0]):
        controller = panda()
        assert controller.set_target("hand", quaternion=quaternion)
        steps.append(controller.step().v)
    assert np.abs(steps[0] - steps[1]).max() < ROUNDING
    assert np.abs(steps[0] - steps[2]).max() < 1e-9


def test_a_name_that_does_not_exist_raises_with_those_that_do() -> None:
    with pytest.raises(rmrc.ModelError, match=r"no task named 'hnad'; did you mean 'hand'\?"):
        panda().set_target("hnad", [0, 0, 0])


def test_inputs_of_other_types_and_strides_are_taken_as_they_are_meant() -> None:
    controller, twin = panda(), panda()
    start = controller.problem.start
    position = ahead(controller, 0.1, 0.0, 0.0)
    controller.set_target("hand", position.tolist())
    twin.set_target("hand", np.repeat(position, 2)[::2])
    wide = np.zeros(14)
    wide[::2] = start
    expected = controller.step(start.tolist()).v
    assert np.array_equal(twin.step(wide[::2]).v, expected)


def test_a_joint_outside_its_range_comes_back_monotonically() -> None:
    controller = panda(limits={"velocity": {"default": 1.0}, "position": {"gain": 1.0}})
    model = controller.problem.model
    q = controller.problem.start.copy()
    q[3] = model.jnt_range[3, 1] + 0.1
    controller.set_target("hand", ahead(controller, 0.3, 0.0, 0.3))
    excess, recovering = [], 0
    for _ in range(200):
        step = controller.step(q)
        recovering += Status.RECOVERING in step.flags
        q = step.q
        excess.append(max(q[3] - model.jnt_range[3, 1], 0.0))
        assert np.abs(step.v).max() <= 1.0
    assert np.all(np.diff(excess) <= 0)
    assert excess[-1] <= RANGE_ROUNDING
    assert recovering == pytest.approx(0.1 / (1.0 * 0.002), abs=2)


def test_limits_hold_at_every_step_towards_a_target_out_of_reach() -> None:
    controller = panda(limits={"velocity": {"default": 1.5}, "acceleration": {"default": 20.0}})
    model = controller.problem.model
    controller.set_target("hand", [3.0, 2.0, 0.1])
    v = np.zeros(7)
    for _ in range(2000):
        step = controller.step()
        assert np.abs(step.v).max() <= 1.5 + ROUNDING
        assert np.abs(step.v - v).max() <= 20.0 * 0.002 + ROUNDING
        assert (step.q >= model.jnt_range[:, 0] - RANGE_ROUNDING).all()
        assert (step.q <= model.jnt_range[:, 1] + RANGE_ROUNDING).all()
        v = step.v


def test_dofs_leave_the_other_columns_out() -> None:
    free = panda()
    part = panda(dofs=["joint2", "joint4", "joint6"], damping={"curvature": "off"})
    target = ahead(free, 0.01, 0.0, 0.01)
    part.set_target("hand", target)
    step = part.step()
    assert np.array_equal(np.flatnonzero(step.v), [1, 3, 5])
    assert part.engine.assembly.qp.H.shape == (3, 3)
    evaluation = part.engine.evaluation
    columns = evaluation.jacobian[:, [1, 3, 5]]
    rate = 10.0 * evaluation.error
    expected = np.linalg.solve(columns.T @ columns + 1e-4 * np.eye(3), columns.T @ rate)
    assert step.v[[1, 3, 5]] == pytest.approx(expected, abs=1e-9)


def test_freeze_holds_its_joints_exactly() -> None:
    controller = panda(tasks=[{"name": "still", "type": "freeze", "joints": ["joint1", "joint5"]}])
    controller.set_target("hand", ahead(controller, 0.1, 0.1, 0.1))
    rates = np.array([controller.step().v for _ in range(100)])
    assert not rates[:, [0, 4]].any()
    assert np.abs(rates).max() > 0.01


def test_velocity_and_smooth_tasks_do_what_they_say() -> None:
    rates = {"name": "spin", "type": "velocity", "target": {"joint1": 0.4}, "B": 1e3}
    spin = rmrc.Controller(rmrc.compile(config(PANDA, [rates])))
    assert spin.step().v == pytest.approx([0.4, 0, 0, 0, 0, 0, 0], abs=1e-6)
    assert spin.set_target("spin", velocity=[0.1, 0, 0, 0, 0, 0, 0])
    assert spin.step().v[0] == pytest.approx(0.1, abs=1e-6)
    smooth = panda(tasks=[{"name": "smooth", "type": "smooth", "B": 10.0}])
    rough = panda()
    for controller in (smooth, rough):
        controller.set_target("hand", ahead(controller, 0.1, 0.0, 0.0))
    first = np.linalg.norm(smooth.step().v)
    assert first < 0.2 * np.linalg.norm(rough.step().v)
    assert np.linalg.norm(smooth.step().v) > first


def test_reset_starts_again() -> None:
    controller = panda()
    controller.set_target("hand", ahead(controller, 0.1, 0.0, 0.0))
    steps = [controller.step().v for _ in range(5)]
    controller.reset()
    assert np.array_equal(controller.step().v, np.zeros(7))
    controller.reset()
    controller.set_target("hand", ahead(controller, 0.1, 0.0, 0.0))
    assert np.array_equal([controller.step().v for _ in range(5)], steps)
    with pytest.raises(rmrc.ModelError, match="7 finite numbers"):
        controller.reset([0.0])


def test_a_gain_above_one_over_dt_is_one_over_dt() -> None:
    steps = []
    for gain in (500.0, 5000.0, "deadbeat"):
        task = {**HAND, "gain": gain}
        controller = rmrc.Controller(
            rmrc.compile(config(PANDA, [task], dt=0.002, limits={"velocity": "off"}))
        )
        controller.set_target("hand", ahead(controller, 1e-3, 0.0, 0.0))
        steps.append(controller.step().v)
    assert np.array_equal(steps[0], steps[1])
    assert np.array_equal(steps[0], steps[2])


def test_a_clamped_error_is_approached_at_constant_speed() -> None:
    task = {**HAND, "clamp": {"position": 0.01}, "B": {"position": 1.0, "orientation": 0.0}}
    controller = rmrc.Controller(rmrc.compile(config(PANDA, [task], damping={"lambda": 1e-4})))
    target = ahead(controller, 0.0, 0.0, -0.2)
    controller.set_target("hand", target)
    reached = controller.problem.forward(controller.step().q)["hand"][:3, 3]
    # K · clamp = 10 · 0.01 m/s, less what the discretisation and the damping take
    assert (0.2 - np.linalg.norm(target - reached)) / 0.002 == pytest.approx(0.1, rel=1e-2)


def test_every_backend_takes_the_same_steps() -> None:
    results = {}
    for backend in ("daqp", "proxqp", "osqp"):
        controller = panda(solver={"backend": backend}, limits={"velocity": {"default": 0.5}})
        controller.set_target("hand", [0.3, 0.5, 0.3])
        results[backend] = np.array([controller.step().v for _ in range(200)])
    assert np.abs(results["proxqp"] - results["daqp"]).max() < 1e-6
    assert np.abs(results["osqp"] - results["daqp"]).max() < 1e-6


def test_one_iteration_gives_a_feasible_point_and_says_so() -> None:
    for backend in ("daqp", "proxqp", "osqp"):
        controller = panda(
            solver={"backend": backend, "max_iter": 1}, limits={"velocity": {"default": 0.2}}
        )
        controller.set_target("hand", [0.6, -0.5, 0.1])
        exhausted = 0
        for _ in range(20):
            step = controller.step()
            exhausted += Status.MAX_ITER in step.flags
            assert np.abs(step.v).max() <= 0.2
            assert Status.MAX_ITER in step.flags or step.solution.kkt.largest < 1e-6
        # For the first-order methods one iteration and a polish are enough now and then.
        assert exhausted or backend != "daqp"


@pytest.mark.parametrize("axes", ["body", "world"])
def test_a_clamp_shortens_the_error_and_leaves_its_jacobian(axes: str) -> None:
    jacobians, rates = [], []
    for clamp in ({}, {"clamp": {"position": 0.05}}):
        controller = rmrc.Controller(rmrc.compile(config(PANDA, [{**HAND, "axes": axes, **clamp}])))
        assert controller.set_target("hand", ahead(controller, 3.0, -4.0, 12.0), [0.1, 0.9, 0.2, 0])
        controller.step()
        jacobians.append(controller.engine.evaluation.jacobian.copy())
        rates.append(controller.engine.assembly.rate.copy())
    assert np.array_equal(*jacobians)
    assert np.linalg.norm(rates[1][:3]) == pytest.approx(10.0 * 0.05)
    shortened = rates[0][:3] * (0.5 / np.linalg.norm(rates[0][:3]))
    assert rates[1] == pytest.approx(np.concatenate([shortened, rates[0][3:]]))
