"""With no limit active, the step is the closed form v = (JᵀBJ + A + λ²I)⁻¹ JᵀB ẋ."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

import rmrc
from models import ROBOTS, config, random_configuration, random_quaternion, scene_path

# Relative to the largest rate: both sides solve the same normal equations, of condition ≤ 1e6.
CLOSED_FORM = 1e-9

OFF = {"position": "off", "velocity": "off"}


def random_weight(rng: np.random.Generator, size: int) -> np.ndarray:
    """Return a symmetric positive definite matrix of a condition of about 100."""
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    return root @ root.T + 0.05 * np.eye(size)


@pytest.mark.parametrize("robot", ROBOTS)
@seed(0)
@settings(max_examples=25, deadline=None)
@given(
    number=st.integers(0, 2**31),
    damping=st.floats(0.01, 1.0),
    axes=st.sampled_from(["body", "world"]),
)
def test_step_is_the_closed_form(robot, number, damping, axes, tmp_path_factory) -> None:
    rng = np.random.default_rng(number)
    scene = scene_path(robot, Path(tmp_path_factory.getbasetemp()))
    site, root = ROBOTS[robot]
    tasks = [
        {
            "name": "hand",
            "type": "frame",
            "frame": {"site": site},
            "axes": axes,
            "clamp": {"position": 50.0},  # the formula has none
            "B": random_weight(rng, 6).tolist(),
            "gain": rng.uniform(1, 20),
        },
        {
            "name": "other",
            "type": "relative_frame",
            "frame": {"site": site},
            "root": root,
            "B": random_weight(rng, 6).tolist(),
        },
        {"name": "com", "type": "com", "B": random_weight(rng, 3).tolist(), "gain": 3.0},
    ]
    bare = rmrc.compile(config(scene, tasks))
    nv = bare.model.nv
    metric = random_weight(rng, nv)
    problem = rmrc.compile(
        config(scene, tasks, metric=metric.tolist(), damping={"lambda": damping}, limits=OFF)
    )
    controller = rmrc.Controller(problem)
    controller.set_target(
        "hand",
        problem.term["hand"].target[4:] + rng.normal(size=3),
        random_quaternion(rng),
        rng.normal(size=6),
    )
    q = random_configuration(problem.model, problem.start, rng, 0.5)
    step = controller.step(q)

    evaluation = controller.engine.evaluation
    hessian, gradient = metric + damping**2 * np.eye(nv), np.zeros(nv)
    for term in evaluation.terms:
        rows = evaluation.rows_of([term])
        jacobian, weight = evaluation.jacobian[rows], term.weight
        if weight.ndim == 1:
            weight = np.diag(weight)
        rate = term.gain * evaluation.error[rows] + evaluation.feedforward[rows]
        hessian += jacobian.T @ weight @ jacobian
        gradient += jacobian.T @ weight @ rate
    expected = np.linalg.solve(hessian, gradient)
    assert step.status is rmrc.Status.OK
    assert np.abs(step.v - expected).max() <= CLOSED_FORM * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_primal_and_dual_forms_agree_with_the_step(robot, tmp_path) -> None:
    rng = np.random.default_rng(3)
    site, _ = ROBOTS[robot]
    weight = random_weight(rng, 6)
    scene = scene_path(robot, tmp_path)
    tasks = [{"name": "hand", "type": "frame", "frame": {"site": site}, "B": weight.tolist()}]
    damping = 0.3
    problem = rmrc.compile(config(scene, tasks, damping={"lambda": damping}, limits=OFF))
    controller = rmrc.Controller(problem)
    controller.set_target("hand", problem.term["hand"].target[4:] + [0.1, -0.2, 0.1])
    step = controller.step()
    evaluation = controller.engine.evaluation
    jacobian, rate = evaluation.jacobian, 10.0 * evaluation.error
    inverse = np.eye(problem.model.nv) / damping**2
    dual = (
        inverse
        @ jacobian.T
        @ np.linalg.solve(jacobian @ inverse @ jacobian.T + np.linalg.inv(weight), rate)
    )
    assert np.abs(step.v - dual).max() <= CLOSED_FORM * max(1.0, np.abs(dual).max())
