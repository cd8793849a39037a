"""As λ → 0 the QP tends to the pseudo-inverse, each singular direction at its λ²/(σ² + λ²)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from random_robots import (
    asked,
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    planar_arm,
    random_moment,
    random_robot,
)

# Rounding of JᵀJ and Jᵀẋ, of the order of 100, over the least eigenvalue of the QP's matrix, λ².
ROUNDING = 1e-12
# Rounding, times the condition of JᵀBJ: 1e7 at the least σ, below.
INVERSE = 1e-8
LEAST_SIGMA = 0.02

dampings = st.sampled_from([1.0, 1e-1, 1e-2, 1e-3])


def assert_rate(qp, pinv, moment, damping: float) -> None:
    """Assert that the QP's v falls short of the pseudo-inverse's by the rate in every direction."""
    v, damped = moment.step(pinv).v, moment.step(qp).v
    _, sigma, directions = np.linalg.svd(asked(pinv)[0])
    share = np.ones(v.size)  # of what lies in the null space
    share[: sigma.size] = damping**2 / (sigma**2 + damping**2)
    assert_close(directions @ (v - damped), share * (directions @ v), ROUNDING / damping**2)


@each_robot
@examples(15)
@given(numbers, dampings)
def test_the_qp_tends_to_the_pseudo_inverse_at_its_rate(
    robot, tmp_path_factory, number, damping
) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    qp = arm.controller(arm.hand(), damping={"lambda": damping})
    pinv = arm.controller(arm.hand(), method="pinv")
    assert_rate(qp, pinv, random_moment(qp, rng), damping)


@examples(15)
@given(numbers, dampings)
def test_and_so_it_does_where_the_arm_is_singular(tmp_path_factory, number, damping) -> None:
    rng = np.random.default_rng(number)
    lengths = rng.uniform(0.3, 1.2, rng.integers(2, 7))
    arm = planar_arm(lengths, tmp_path_factory.getbasetemp()).asking(0, 1)
    qp = arm.controller(arm.hand(axes="world"), damping={"lambda": damping})
    pinv = arm.controller(arm.hand(axes="world"), method="pinv")
    straight = np.append(rng.uniform(-2.0, 2.0), np.zeros(lengths.size - 1))
    assert_rate(qp, pinv, replace(random_moment(qp, rng), q=straight), damping)


@pytest.mark.parametrize("robot", ["planar", "ur5e"])
@examples(15)
@given(numbers)
def test_a_square_arm_has_one_solution_by_every_method(robot, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    if robot == "ur5e":
        arm = arm.asking(*range(6))
    assume(len(arm.rows) == arm.joints)
    task = arm.hand(definite(rng, arm.joints))
    inverse = arm.controller(task, method="inverse")
    moment = random_moment(inverse, rng)
    v = moment.step(inverse).v
    jacobian, rate = asked(inverse)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    assert_close(jacobian @ v, rate, INVERSE)
    metric = definite(rng, arm.joints).tolist()
    for method in ("qp", "dls", "pinv", "nullspace", "saturated"):
        assert_close(moment.step(arm.controller(task, method=method)).v, v, INVERSE)
    weighted = arm.controller(task, method="weighted", metric=metric)
    assert_close(moment.step(weighted).v, v, INVERSE)
