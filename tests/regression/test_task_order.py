"""The order that the tasks are written in does not matter; their levels do."""

import numpy as np
import pytest
from hypothesis import given
from random_robots import (
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
)

from models import random_quaternion

# Rounding of sums in another order, times conditions up to 1e5.
SAME_SUM = 1e-9

METHODS = ("transpose", "pinv", "dls", "sdls", "nullspace", "saturated", "descent")
WAYS = {
    "soft": {},
    "strict": {"priority": "strict"},
    "limits": {"limits": {"velocity": {"default": 0.3}}},
    "strict limits": {"priority": "strict", "limits": {"velocity": {"default": 0.3}}},
    **{method: {"method": method} for method in METHODS},
}


@each_robot
@pytest.mark.parametrize("way", WAYS)
@examples(3)
@given(numbers)
def test_tasks_may_be_written_in_any_order(robot, way, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    tasks = [
        arm.hand(definite(rng, len(arm.rows))),
        {"name": "world", "type": "frame", "frame": arm.root, "axes": "world"},
        {"name": "com", "type": "com", "B": definite(rng, 3).tolist(), "level": 1},
        {"name": "look", "type": "look_at", "frame": {"site": arm.site}, "level": 1},
        {"name": "posture", "type": "posture", "B": 0.1, "level": 2},
        {"name": "smooth", "type": "smooth", "B": 0.1, "level": 2},
    ]
    position, quaternion = rng.normal(size=3), random_quaternion(rng)
    options = {"damping": {"lambda": 0.1}, **WAYS[way]}
    moment, rates = None, []
    for order in (range(len(tasks)), rng.permutation(len(tasks))):
        controller = arm.controller(*(tasks[k] for k in order), **options)
        moment = moment or random_moment(controller, rng)
        assert controller.set_target("world", position, quaternion)
        assert controller.set_target("com", position)
        moment.step(controller)
        rates.append(moment.step(controller).v)  # the second, which has a velocity to keep
    assert_close(rates[1], rates[0], SAME_SUM)


@each_robot
@examples(3)
@given(numbers)
def test_levels_matter(robot, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    moment, rates = None, []
    for hand, com in ((0, 1), (1, 0)):
        tasks = (arm.hand(level=hand), {"name": "com", "type": "com", "level": com})
        controller = arm.controller(*tasks, damping={"lambda": 0.1}, priority="strict")
        moment = moment or random_moment(controller, rng)
        rates.append(moment.step(controller).v)
    assert np.abs(rates[1] - rates[0]).max() > 1e3 * SAME_SUM
