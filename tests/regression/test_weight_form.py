"""A weight means the same as a diagonal, as a matrix and as two numbers, by every method."""

import numpy as np
import pytest
from hypothesis import given
from random_robots import assert_close, examples, numbers, random_moment, random_robot

# The square roots of B differ by rotations: rounding, times conditions up to 1e4.
SAME_WEIGHT = 1e-9

METHODS = (
    "transpose",
    "pinv",
    "weighted",
    "dls",
    "sdls",
    "nullspace",
    "saturated",
    "descent",
)
WAYS = {
    "qp": {},
    "strict": {"priority": "strict"},
    "direction": {},
    **{method: {"method": method} for method in METHODS},
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("robot", ["panda", "ur5e", "biped"])
@examples(3)
@given(numbers)
def test_the_form_of_a_weight_does_not_matter(robot, way, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp()).asking(0, 1, 2)
    options = {"metric": 1.0, "damping": {"lambda": 0.1}, **WAYS[way]}
    task = arm.hand(preserve="direction" if way == "direction" else None)
    diagonal = arm.controller(task, **options)
    moment = random_moment(diagonal, rng)
    v = moment.step(diagonal).v
    for weight in (np.diag([1.0, 1, 1, 0, 0, 0]).tolist(), {"position": 1.0, "orientation": 0.0}):
        other = arm.controller({**task, "B": weight}, **options)
        assert_close(moment.step(other).v, v, SAME_WEIGHT)
