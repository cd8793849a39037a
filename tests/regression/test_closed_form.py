"""With no limit active, the step is the closed form v = (JᵀBJ + A + λ²I)⁻¹ JᵀB ẋ."""

from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

import rmrc
from models import ROBOTS, config, random_configuration, scene_path

# Relative to the largest rate: both sides solve the same normal equations, of condition ≤ 1e6.
CLOSED_FORM = 1e-9
# An error, of 1 m and 1 rad, at which the curvature of the tasks is next to nothing: X is about
# dt K ‖B e‖ times a few levers, 1e-7, over the least eigenvalue of JᵀBJ + A + λ²I, 0.05.
SMALL_ERROR, SMALL_CURVATURE = 1e-6, 1e-5

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
    folder = Path(tmp_path_factory.getbasetemp())
    options = {"lambda": damping, "curvature": "off"}
    step, expected = step_and_closed_form(robot, number, options, axes, 1.0, folder)
    assert step.status is rmrc.Status.OK
    assert np.abs(step.v - expected).max() <= CLOSED_FORM * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("axes", ["body", "world"])
def test_the_curvature_vanishes_with_the_error(robot, axes, tmp_path) -> None:
    options = {"lambda": 0.1, "curvature": "on"}
    apart = []
    for size in (1e-3, SMALL_ERROR):
        step, expected = step_and_closed_form(robot, 0, options, axes, size, tmp_path)
        assert step.status is rmrc.Status.OK
        apart.append(np.abs(step.v - expected).max() / np.abs(expected).max())
    assert apart[1] <= SMALL_CURVATURE
    # In proportion, unless what is left is rounding.
    assert apart[1] <= 1.5 * SMALL_ERROR / 1e-3 * apart[0] + CLOSED_FORM


def step_and_closed_form(
    robot: str, number: int, damping: dict[str, Any], axes: str, size: float, folder: Path
) -> tuple[rmrc.Step, np.ndarray]:
    """Return a step and v of the formula, for errors of about `size` times 1 m and 1 rad."""
    rng = np.random.default_rng(number)
    scene = scene_path(robot, folder)
    site, root = ROBOTS[robot]
    tasks = [
        {
            "name": "hand",
            "type": "frame",
            "frame": {"site": site},
            "axes": axes,
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
    model = mujoco.MjModel.from_xml_path(scene)
    metric = random_weight(rng, model.nv)
    problem = rmrc.compile(
        config(scene, tasks, metric=metric.tolist(), damping=damping, limits=OFF)
    )
    controller = rmrc.Controller(problem)
    target = problem.term["hand"].target
    turn = mink.SO3.exp(size * np.pi * rng.uniform(-0.57, 0.57, 3)) @ mink.SO3(target[:4])
    velocity = rng.normal(size=6) if size == 1.0 else None
    controller.set_target("hand", target[4:] + size * rng.normal(size=3), turn.wxyz, velocity)
    q = random_configuration(problem.model, problem.start, rng, 0.5 * size)
    step = controller.step(q)

    evaluation = controller.engine.evaluation
    hessian = metric + damping["lambda"] ** 2 * np.eye(model.nv)
    gradient = np.zeros(model.nv)
    for term in evaluation.terms:
        rows = evaluation.rows_of([term])
        jacobian, weight = evaluation.jacobian[rows], term.weight
        if weight.ndim == 1:
            weight = np.diag(weight)
        rate = term.gain * evaluation.error[rows] + evaluation.feedforward[rows]
        hessian += jacobian.T @ weight @ jacobian
        gradient += jacobian.T @ weight @ rate
    return step, np.linalg.solve(hessian, gradient)


@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_primal_and_dual_forms_agree_with_the_step(robot, tmp_path) -> None:
    rng = np.random.default_rng(3)
    site, _ = ROBOTS[robot]
    weight = random_weight(rng, 6)
    scene = scene_path(robot, tmp_path)
    tasks = [{"name": "hand", "type": "frame", "frame": {"site": site}, "B": weight.tolist()}]
    damping = 0.3
    options = {"lambda": damping, "curvature": "off"}
    problem = rmrc.compile(config(scene, tasks, damping=options, limits=OFF))
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
