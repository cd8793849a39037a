"""Whatever the target, the gain, λ, the step and the limits: V does not rise, and nothing shakes.

V = ½ eᵀBe is computed from MuJoCo's forward kinematics and mink's logarithms at what is commanded.
"""

from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config, random_quaternion
from soaking.shaking import Shaking

Array = NDArray[np.float64]

SECONDS, FEWEST = 4.0, 200
"""How long a run is, at least so many steps."""
CLOSELY = 400
"""Steps at the start whose V is looked at, and how many pairs of steps later."""
RISE, ROUNDING = 1e-9, 1e-12
"""Share of V that rounding may add, and what it may add where V is near 0."""
ROBOTS = {"panda": "hand", "ur5e": "tool", "planar_3r": "hand"}
DIMENSIONS = {"panda": 3, "ur5e": 3, "planar_3r": 2}


def potential(model: mujoco.MjModel, site: str, task: Any, target: mink.SE3, q: Array) -> float:
    """Return ½ eᵀBe at q (nq,)."""
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_kinematics(model, data)
    turn = mink.SO3.from_matrix(data.site(site).xmat.reshape(3, 3))
    pose = mink.SE3.from_rotation_and_translation(turn, data.site(site).xpos)
    if task.axes == "body":
        error = pose.inverse().multiply(target).log()
    else:
        turned = target.rotation().multiply(turn.inverse()).log()
        error = np.r_[target.translation() - pose.translation(), turned]
    weight = np.repeat([1.0, task.B.orientation], 3)
    return 0.5 * float(error @ (weight * error))


@pytest.mark.parametrize("robot", ROBOTS)
@seed(12)
@settings(
    max_examples=3,
    deadline=None,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    number=st.integers(0, 2**32 - 1),
    dt=st.sampled_from([1e-4, 5e-4, 2e-3, 5e-3, 2e-2, 0.1]),
    gain=st.one_of(st.floats(0.5, 100.0), st.just("deadbeat")),
    damping=st.sampled_from([1e-4, 1e-3, 1e-2, 0.1]),
    speed=st.floats(0.2, 10.0),
    far=st.sampled_from([0.1, 0.5, 1.0, 3.0, 100.0]),
    axes=st.sampled_from(["body", "world"]),
    turned=st.sampled_from([0.0, 0.3, 1.0]),
)
def test_it_rests_wherever_it_is_sent(
    robot: str,
    number: int,
    dt: float,
    gain: float | str,
    damping: float,
    speed: float,
    far: float,
    axes: str,
    turned: float,
) -> None:
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    site, rng = ROBOTS[robot], np.random.default_rng(number)
    weights = {"position": 1.0, "orientation": turned}
    task = {"name": "hand", "type": "frame", "frame": {"site": site}, "B": weights, "axes": axes}
    made = config(
        str(REPOSITORY / "scenes" / f"{robot}.xml"),
        [task | {"gain": gain}],
        dt=dt,
        limits={"velocity": {"default": speed}},
        damping={"lambda": damping},
    )
    problem = rmrc.compile(made)
    box, start = problem.box, problem.start.copy()
    low, high = np.maximum(box.lower, -np.pi), np.minimum(box.upper, np.pi)
    start[box.coordinate] = low + (high - low) * rng.uniform(0.05, 0.95, low.size)
    place = problem.forward(start)["hand"][:3, 3]
    place[: DIMENSIONS[robot]] += far * rng.normal(size=DIMENSIONS[robot])
    turn = random_quaternion(rng)
    target = mink.SE3.from_rotation_and_translation(mink.SO3(turn), place)

    controller = rmrc.Controller(problem, "native")
    controller.reset(start)
    assert controller.set_target("hand", position=place, quaternion=turn)
    steps, before = max(FEWEST, round(SECONDS / dt)), np.inf
    shaking = Shaking(problem.dofs.size)
    every = max(1, steps // CLOSELY)
    for k in range(steps):
        step = controller.step()
        assert not shaking.update(step.v, dt)
        if k >= CLOSELY and k % every > 1:
            continue
        now = potential(problem.model, site, made.tasks[0], target, step.q)
        if k < CLOSELY or every == 1 or k % every == 1:
            assert now <= before * (1.0 + RISE) + ROUNDING
        before = now
