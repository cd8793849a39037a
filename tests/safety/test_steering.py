"""While it runs: twists, a hold, several targets at once, and where the frames are."""

from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "level": 1}
LIMITS: dict[str, Any] = {"velocity": {"default": 1.5}, "acceleration": {"default": 8.0}}
ENGINES = ("python", "native")
EXACT = 1e-12
"""Of MuJoCo's kinematics at the same q."""
STEERED = 2e-3
"""m/s and rad/s: of a twist what λ² and the posture take at a gain of 10/s."""
HELD = 1e-5
"""m: what a frame may be away after a minute from where it stopped."""
ROUNDING = 1e-9


def controller(engine: Any, limits: dict[str, Any] = LIMITS) -> rmrc.Controller:
    made = config(PANDA, [HAND, POSTURE], limits=limits, start="home", dt=0.002)
    return rmrc.Controller(rmrc.compile(made), engine)


def at(problem: rmrc.Problem, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(problem.model)
    data.qpos = q
    mujoco.mj_forward(problem.model, data)
    return data


def moved(problem: rmrc.Problem, step: rmrc.Step) -> np.ndarray:
    """Return the twist (6,) of the hand in a step."""
    data, jacobian = at(problem, step.moment.q), np.zeros((6, problem.model.nv))
    site = problem.model.site("hand").id
    mujoco.mj_jacSite(problem.model, data, jacobian[:3], jacobian[3:], site)
    return jacobian @ step.v


def after(controller: rmrc.Controller, count: int) -> rmrc.Step:
    """Return the last of so many steps."""
    return [controller.step() for _ in range(count)][-1]


def smoothly(controller: rmrc.Controller, count: int, before: np.ndarray, most: float) -> rmrc.Step:
    """Return the last of so many steps, none of which changes a rate by more than `most`."""
    steps = [controller.step() for _ in range(count)]
    rates = np.array([before, *(step.v for step in steps)])
    assert np.abs(np.diff(rates, axis=0)).max() <= most
    return steps[-1]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_twist_moves_the_frame_and_zero_holds_it_where_it_stops(engine: Any) -> None:
    made = controller(engine)
    problem, before = made.problem, np.zeros(7)
    twist = np.array([0.05, 0.1, -0.05, 0.1, 0.0, 0.2])
    assert made.set_twist("hand", twist)
    most = 8.0 * problem.dt + ROUNDING
    step = smoothly(made, 300, before, most)
    before = step.v
    assert np.abs(moved(problem, step) - twist).max() < STEERED
    assert made.set_twist("hand", np.zeros(6))
    step = smoothly(made, 300, before, most)
    before = step.v
    stopped = at(problem, step.q).site("hand").xpos.copy()
    step = after(made, 3000)
    assert np.linalg.norm(at(problem, step.q).site("hand").xpos - stopped) < HELD


@pytest.mark.parametrize("engine", ENGINES)
def test_a_twist_ends_with_a_target(engine: Any) -> None:
    made = controller(engine)
    made.set_twist("hand", [0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    made.step()
    assert made.set_target("hand", position=[0.4, 0.2, 0.4])
    step = after(made, 2500)
    found = at(made.problem, step.q).site("hand").xpos
    assert np.linalg.norm(found - [0.4, 0.2, 0.4]) < 1e-3


@pytest.mark.parametrize("twist", [[1.0, 2.0], "up", [np.nan] * 6, None])
def test_a_twist_that_is_none_is_refused_and_said(twist: Any) -> None:
    made = controller("python")
    assert not made.set_twist("hand", twist)
    step = made.step()
    assert step.status is rmrc.Status.INVALID_INPUT
    assert any("twist of hand" in reason for reason in step.reasons)


def test_only_frames_have_twists() -> None:
    made = controller("python")
    with pytest.raises(rmrc.ModelError, match="'posture' is a posture"):
        made.set_twist("posture", np.zeros(6))
    with pytest.raises(rmrc.ModelError, match="did you mean 'hand'"):
        made.set_twist("hadn", np.zeros(6))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hold_brakes_inside_the_limits_and_stays(engine: Any) -> None:
    made = controller(engine)
    made.set_target("hand", position=[0.3, 0.5, 0.3])
    step = after(made, 150)
    assert np.abs(step.v).max() > 0.3
    made.hold()
    step = smoothly(made, 200, step.v, 8.0 * made.problem.dt + ROUNDING)
    assert np.abs(step.v).max() == 0.0
    stays = step.q
    assert made.set_target("hand", position=[0.5, 0.0, 0.3])
    step = after(made, 50)
    np.testing.assert_array_equal(step.q, stays)
    made.resume()
    step = after(made, 2500)
    found = at(made.problem, step.q).site("hand").xpos
    assert np.linalg.norm(found - [0.5, 0.0, 0.3]) < 1e-3


@pytest.mark.parametrize("engine", ENGINES)
def test_a_held_controller_takes_the_same_steps_again(engine: Any) -> None:
    made, twin = controller(engine), controller(engine)
    made.hold()
    made.step()
    made.resume()
    for each in (made, twin):
        each.set_target("hand", position=[0.4, 0.2, 0.4])
    for _ in range(50):
        np.testing.assert_array_equal(made.step().v, twin.step().v)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_pose_and_a_jacobian_are_mujocos(engine: Any) -> None:
    made = controller(engine)
    made.set_target("hand", position=[0.4, 0.3, 0.4])
    step = after(made, 20)
    data, jacobian = at(made.problem, step.q), np.zeros((6, 7))
    site = data.site("hand")
    np.testing.assert_allclose(made.pose("hand")[:3, 3], site.xpos, atol=EXACT)
    np.testing.assert_allclose(made.pose("hand")[:3, :3].ravel(), site.xmat, atol=EXACT)
    mujoco.mj_jacSite(made.problem.model, data, jacobian[:3], jacobian[3:], site.id)
    np.testing.assert_allclose(made.jacobian("hand"), jacobian, atol=EXACT)
    with pytest.raises(rmrc.ModelError, match="hand"):
        made.pose("posture")


def test_targets_of_several_tasks_come_at_once() -> None:
    made = controller("native")
    pose = made.pose("hand")
    pose[:3, 3] += [0.05, 0.0, 0.05]
    q = np.array([0.1, -0.5, 0.0, -2.0, 0.0, 1.5, 0.5])
    assert made.set_targets({"hand": pose, "posture": {"q": q}})
    step = after(made, 3000)
    assert np.linalg.norm(at(made.problem, step.q).site("hand").xpos - pose[:3, 3]) < 1e-3
    assert not made.set_targets({"hand": [0.1, 0.2]})
    with pytest.raises(rmrc.ModelError, match="hand"):
        made.set_targets({"hnad": pose})


def test_what_is_printed_is_short() -> None:
    made = controller("python")
    assert str(made.step().status) in rmrc.Status.__members__
    assert repr(made) == (
        "Controller(Problem(7 dofs, tasks: hand, posture, dt=0.002), engine='python')"
    )
