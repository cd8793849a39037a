"""The weighted least norm is the strict QP with its metric, and the limit of the soft one."""

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
    random_moment,
    random_robot,
)

# Past two programs, the first damped by 1e-12 over σ² ≥ 4e-4.
STRICT = 1e-7
LEAST_SIGMA = 0.02
# Rounding, times the condition of JᵀBJ + εA: 1e9 at the least ε, 1e-6.
RATE = 1e-6

METRICS = {
    "diagonal": lambda rng, nv: rng.uniform(0.1, 3.0, nv).tolist(),
    "matrix": lambda rng, nv: definite(rng, nv).tolist(),
    "inertia": lambda rng, nv: "inertia",
}


@each_robot
@pytest.mark.parametrize("metric", METRICS)
@examples(8)
@given(numbers)
def test_weighted_is_the_strict_qp(robot, metric, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    task = arm.hand(definite(rng, len(arm.rows)))
    options = {"metric": METRICS[metric](rng, arm.controller(task).problem.model.nv)}
    qp = arm.controller(task, priority="strict", **options)
    moment = random_moment(qp, rng)
    v = moment.step(qp).v
    assume(np.linalg.svd(asked(qp)[0], compute_uv=False)[-1] >= LEAST_SIGMA)
    assert_close(moment.step(arm.controller(task, method="weighted", **options)).v, v, STRICT)


@each_robot
@examples(15)
@given(numbers, st.sampled_from([1.0, 1e-2, 1e-4, 1e-6]))
def test_the_qp_tends_to_the_weighted_least_norm_at_its_rate(
    robot, tmp_path_factory, number, scale
) -> None:
    # With w = Lᵀv for A = LLᵀ it is the pseudo-inverse's rate, of √B J L⁻ᵀ, with ε for λ².
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    weight = definite(rng, len(arm.rows))
    task = arm.hand(weight)
    metric = definite(rng, arm.controller(task).problem.model.nv)
    weighted = arm.controller(task, method="weighted", metric=metric.tolist())
    qp = arm.controller(task, metric=(scale * metric).tolist())
    moment = random_moment(qp, rng)
    v, short = moment.step(weighted).v, moment.step(qp).v
    jacobian, _ = asked(qp)
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] >= LEAST_SIGMA)
    factor = np.linalg.cholesky(metric).T
    scaled = np.linalg.cholesky(weight).T @ jacobian @ np.linalg.inv(factor)
    _, sigma, directions = np.linalg.svd(scaled)
    share = np.ones(v.size)
    share[: sigma.size] = scale / (sigma**2 + scale)
    directions = directions @ factor
    assert_close(directions @ (v - short), share * (directions @ v), RATE)
