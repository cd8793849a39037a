"""The curvature of the tasks: X against finite differences of V at random configurations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import config
from rmrc.control.controller import Controller
from rmrc.problem.evaluation import Evaluation

Array = NDArray[np.float64]

JOINTS = 7
CONFIGURATIONS = 20
STEP = 1e-5
"""rad, of the central differences of the gradient of V."""
NOISE = 1e-6
"""Share of the largest curvature that the differences leave."""
HALF = 0.5
"""Share of X that V not rising asks for; the rest keeps the rates from changing sign."""

TASKS: dict[str, dict[str, Any]] = {
    "world": {"type": "frame", "frame": {"site": "tip"}, "axes": "world"},
    "body": {"type": "frame", "frame": {"site": "tip"}},
    "weighed": {"type": "frame", "frame": {"site": "tip"}, "B": [1.0, 0.1, 3.0, 0.5, 2.0, 0.01]},
    "position": {
        "type": "frame",
        "frame": {"site": "tip"},
        "B": {"position": 1.0, "orientation": 0.0},
    },
    "relative": {"type": "relative_frame", "frame": {"site": "tip"}, "root": {"body": "b2"}},
    "com": {"type": "com"},
    "look_at": {"type": "look_at", "frame": {"site": "tip"}},
    "axis_align": {"type": "axis_align", "frame": {"site": "tip"}},
}


def chain(rng: np.random.Generator, slides: bool) -> str:
    """Return a chain of joints with random axes, lengths and masses."""
    opened = ""
    for k in range(JOINTS):
        axis, place = rng.normal(size=3), 0.3 * rng.normal(size=3)
        kind = "slide" if slides and k % 3 == 1 else "hinge"
        opened += (
            f'<body name="b{k}" pos="{place[0]} {place[1]} {place[2]}">'
            f'<joint name="j{k}" type="{kind}" axis="{axis[0]} {axis[1]} {axis[2]}"/>'
            f'<geom size="0.05" mass="{rng.uniform(0.1, 2.0)}" pos="{0.1 * rng.normal()} 0 0.1"/>'
        )
    tip = 0.3 * rng.normal(size=3)
    opened += f'<site name="tip" pos="{tip[0]} {tip[1]} {tip[2]}"/>' + "</body>" * JOINTS
    return f"<mujoco><worldbody>{opened}</worldbody></mujoco>"


def controller_of(scene: Path, task: dict[str, Any]) -> Controller:
    """Return a controller of one task, without limits."""
    made = config(
        str(scene),
        [{"name": "task", "gain": 1.0, **task}],
        limits={"position": "off", "velocity": "off"},
        damping={"curvature": True},
    )
    return Controller(rmrc.compile(made), "python")


def drawn(controller: Controller, rng: np.random.Generator, far: float) -> None:
    """Give the task a random target."""
    term = controller.problem.terms[0]
    target = controller.engine.evaluation.target[term.name]
    if term.target_kind == "pose":
        turn = rng.normal(size=4)
        target[:4], target[4:] = turn / np.linalg.norm(turn), far * rng.normal(size=3)
    elif term.target_kind == "direction":
        direction = rng.normal(size=3)
        target[:] = direction / np.linalg.norm(direction)
    else:
        target[:] = far * rng.normal(size=3)


def gradient(evaluation: Evaluation, weight: Array, q: Array) -> Array:
    """Return ∇V = −JᵀBe (n,) at q (nq,)."""
    evaluation.update(q)
    evaluation.evaluate()
    return -evaluation.jacobian.T @ weight @ evaluation.error


@pytest.mark.parametrize("far", [0.3, 3.0])
@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("task", TASKS)
def test_the_diagonal_bounds_the_curvature(
    tmp_path: Path, task: str, slides: bool, far: float
) -> None:
    """X + JᵀBJ − ½ dt ∇²V is positive semidefinite: V falls where the step is a small one."""
    rng = np.random.default_rng(len(task) + 2 * slides)
    for k in range(CONFIGURATIONS):
        scene = tmp_path / f"chain{k}.xml"
        scene.write_text(chain(rng, slides))
        controller = controller_of(scene, TASKS[task])
        evaluation, assembly = controller.engine.evaluation, controller.engine.assembly
        weight = assembly.unit * np.diag(controller.problem.terms[0].weight)
        q = rng.uniform(-2.0, 2.0, JOINTS)
        drawn(controller, rng, far)

        hessian = np.array(
            [
                (
                    gradient(evaluation, weight, q + STEP * axis)
                    - gradient(evaluation, weight, q - STEP * axis)
                )
                / (2.0 * STEP)
                for axis in np.eye(JOINTS)
            ]
        )
        gradient(evaluation, weight, q)
        assembly.curvature.update(evaluation.error, 1.0)
        diagonal = assembly.curvature.levels[0]
        normal = evaluation.jacobian.T @ weight @ evaluation.jacobian
        curvature = 0.5 * (hessian + hessian.T) - normal
        least = np.linalg.eigvalsh(np.diag(diagonal) - HALF * curvature)[0]
        assert least >= -NOISE * np.abs(curvature).max()
