"""How far resolved rates leave a straight line falls with dt: by its first order, or its second."""

import numpy as np
import pytest
from hypothesis import given
from random_robots import (
    Robot,
    each_robot,
    examples,
    numbers,
    planar_arm,
    random_robot,
)

# Of the ratio of two deviations: their next order is a share of about ½ K dt = 0.01 of the first.
ORDER = 0.03
DURATION, LENGTH = 0.5, 0.1

# What one step leaves the line by, ½ dt² q̇ᵀHq̇, is taken back at the rate K: K dt of it each step.
WAYS = {
    "fed back": ({"gain": 10.0}, False, 2.0),
    "fed forward and back": ({"gain": 10.0}, True, 2.0),
    "fed forward": ({"gain": 1e-9}, True, 2.0),
    "deadbeat": ({"gain": "deadbeat"}, False, 4.0),
}


def deviation(arm: Robot, q: np.ndarray, line: np.ndarray, way: str, dt: float) -> float:
    """Return the largest distance in m from a straight line (3,) that the hand follows from q."""
    options, forward, _ = WAYS[way]
    controller = arm.controller(arm.hand(axes="world", **options), method="pinv", dt=dt)
    start = controller.problem.forward(q)["hand"][:3, 3]
    along, farthest = line / np.linalg.norm(line), 0.0
    velocity = np.append(line / DURATION, np.zeros(3)) if forward else None
    hand = controller.engine.evaluation.data.site(arm.site)
    for k in range(round(DURATION / dt) + 1):
        assert controller.set_target("hand", start + k * dt / DURATION * line, velocity=velocity)
        q = controller.step(q).q
        gone = hand.xpos - start
        farthest = max(farthest, float(np.linalg.norm(gone - (gone @ along) * along)))
    return farthest


@each_robot
@pytest.mark.parametrize("way", WAYS)
@examples(3)
@given(numbers)
def test_half_the_step_is_half_the_deviation_and_a_quarter_at_deadbeat(
    robot, way, tmp_path_factory, number
) -> None:
    rng = np.random.default_rng(number)
    folder = tmp_path_factory.getbasetemp()
    if robot == "planar":
        arm = planar_arm(rng.uniform(0.4, 1.0, rng.integers(3, 6)), folder).asking(0, 1)
        q = rng.uniform(0.7, 1.0, arm.joints)  # bent: the line is within reach
    else:
        arm = random_robot(robot, rng, folder).asking(0, 1, 2)
        q = arm.controller(arm.hand()).problem.start
    line = rng.normal(size=3) * [1.0, 1.0, robot != "planar"]
    line *= LENGTH / np.linalg.norm(line)
    coarse, fine = (deviation(arm, q, line, way, dt) for dt in (0.005, 0.0025))
    assert coarse / fine == pytest.approx(WAYS[way][2], rel=ORDER)
