"""The pseudo-inverse does not bring a redundant arm back on a closed path; a posture does."""

import numpy as np
import pytest
from random_robots import Robot, unit_links

# Where the hand and the joints are back: rounding of 200 steps, times conditions up to 10.
BACK = 1e-9


def turns(arm: Robot, *tasks: dict, **options) -> list[float]:
    """Return how far in rad each of three turns of the hand on a circle leaves the joints."""
    task = arm.hand(axes="world", gain="deadbeat")
    controller = arm.controller(task, *tasks, **options)
    start = controller.problem.forward(controller.problem.start)["hand"][:3, 3]
    ends = [q := controller.problem.start]
    for _ in range(3):
        for angle in [*np.linspace(0.0, 2.0 * np.pi, 201)[1:], 0.0, 0.0]:  # and settle
            offset = [np.cos(angle) - 1.0, np.sin(angle), 0.0]
            assert controller.set_target("hand", start + 0.3 * np.array(offset))
            q = controller.step().q
        ends.append(q)
        assert np.abs(controller.problem.forward(q)["hand"][:3, 3] - start).max() < BACK
    return np.linalg.norm(np.diff(ends, axis=0), axis=1).tolist()


def test_the_pseudo_inverse_does_not_bring_a_redundant_arm_back() -> None:
    # Klein and Huang 1983: the motion of least norm is not integrable.
    drift = turns(unit_links(3), method="pinv")
    assert drift == pytest.approx([6.2e-3, 6.1e-3, 6.0e-3], rel=0.02)


@pytest.mark.parametrize("way", [{"method": "nullspace"}, {"priority": "strict"}])
def test_a_posture_in_the_null_space_does(way) -> None:
    posture = {"name": "posture", "type": "posture", "level": 1, "gain": "deadbeat"}
    assert max(turns(unit_links(3), posture, **way)) < BACK


def test_an_arm_without_redundancy_comes_back_of_itself() -> None:
    assert max(turns(unit_links(2), method="inverse")) < BACK
