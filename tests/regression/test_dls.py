"""With no limit active, the QP is weighted damped least squares, whatever A, B and λ are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_robots import (
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
    unit_links,
)

import rmrc

# Both factorise the same matrix, of condition up to 1e6.
SAME_SYSTEM = 1e-9

METRICS = {
    "none": lambda rng, nv: 0.0,
    "number": lambda rng, nv: float(rng.uniform(0.1, 1.0)),
    "diagonal": lambda rng, nv: rng.uniform(0.0, 1.0, nv).tolist(),
    "matrix": lambda rng, nv: definite(rng, nv).tolist(),
    "inertia": lambda rng, nv: "inertia",
}


@each_robot
@pytest.mark.parametrize("metric", METRICS)
@examples(6)
@given(numbers, st.floats(0.01, 1.0), st.booleans())
def test_dls_is_the_qp(robot, metric, tmp_path_factory, number, damping, whole) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    hand = arm.hand(
        definite(rng, len(arm.rows)),
        axes=str(rng.choice(["body", "world"])),
        clamp={"position": 0.1, "orientation": 0.2},
    )
    com = {"name": "com", "type": "com", "B": definite(rng, 3).tolist()}
    model = arm.controller(hand).problem.model
    joints = [model.joint(j).name for j in range(model.njnt)]
    options = {
        "damping": {"lambda": damping},
        "metric": METRICS[metric](rng, model.nv),
        "dofs": None if whole else rng.choice(joints, 1 + len(joints) // 2, replace=False).tolist(),
    }
    qp, dls = (arm.controller(hand, com, method=method, **options) for method in ("qp", "dls"))
    moment = random_moment(qp, rng)
    step = moment.step(qp)
    assert step.status is rmrc.Status.OK
    assert_close(moment.step(dls).v, step.v, SAME_SYSTEM)


@pytest.mark.parametrize("method", ["qp", "dls"])
def test_damping_of_the_singular_value_halves_the_rate(method) -> None:
    # J = [0, 0, 0; 3, 2, 1] for unit links along x: σ² = 14 across them, and σ²/(σ² + λ²) = ½.
    arm = unit_links(3)
    options = {"start": [0.0, 0.0, 0.0], "damping": {"lambda": np.sqrt(14.0)}}
    controller = arm.controller(arm.hand(axes="world"), method=method, **options)
    controller.set_target("hand", [3.0, 0.0, 0.0], velocity=[0.3, 1.4, 0, 0, 0, 0])
    assert controller.step().v == pytest.approx([0.15, 0.1, 0.05], abs=SAME_SYSTEM)
