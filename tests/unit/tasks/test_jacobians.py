"""Every task's Jacobian and feed-forward against finite differences on the manifold."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import rmrc
from models import ROBOTS, config, random_configuration, random_quaternion, scene_path
from rmrc.model.lie import pose_of
from rmrc.problem.evaluation import Evaluation
from rmrc.tasks.frame import FrameTerm

STEP = 1e-6
# Central differences err by STEP²·f''' ≈ 1e-12 and by rounding/STEP ≈ 1e-10 · the size of e.
CENTRAL_DIFFERENCE = 1e-8
CONFIGURATIONS = 5


def tasks(site: str, root: dict[str, str]) -> list[dict[str, Any]]:
    frame = {"site": site}
    second = {"site": "middle"} if root == {"site": "root"} else root  # a frame that moves
    return [
        {"name": "frame", "type": "frame", "frame": frame, "clamp": FAR},
        {"name": "second", "type": "frame", "frame": second, "clamp": FAR},
        {"name": "world", "type": "frame", "frame": frame, "axes": "world", "clamp": FAR},
        {"name": "relative", "type": "relative_frame", "frame": frame, "root": root},
        {"name": "com", "type": "com"},
        {"name": "look", "type": "look_at", "frame": frame, "axis": [0.2, -0.3, 1.0]},
        {"name": "align", "type": "axis_align", "frame": frame, "axis": [1.0, 0.5, 0.0]},
        {"name": "posture", "type": "posture"},
    ]


# Beyond its clamp, by default of the robot's length, an error has the Jacobian of a nearer target.
FAR = {"position": 50.0}


@pytest.fixture(params=ROBOTS)
def evaluation(request: pytest.FixtureRequest, tmp_path: Path) -> Evaluation:
    name = request.param
    scene = scene_path(name, tmp_path)
    return Evaluation(rmrc.compile(config(scene, tasks(*ROBOTS[name]))))


def scatter_targets(evaluation: Evaluation, rng: np.random.Generator) -> None:
    for term in evaluation.terms:
        target = evaluation.target[term.name]
        if term.target_kind == "pose":
            target[:4] = random_quaternion(rng)
            target[4:] += rng.normal(size=3)
        elif term.target_kind == "point":
            target += rng.normal(size=3)
        elif term.target_kind == "direction":
            target[:] = random_quaternion(rng)[:3]
            target /= np.linalg.norm(target)
        elif term.target_kind == "configuration":
            start = evaluation.problem.start
            target[:] = random_configuration(evaluation.model, start, rng, 0.5)


def error_at(evaluation: Evaluation, q: np.ndarray) -> np.ndarray:
    evaluation.update(q)
    evaluation.evaluate()
    return evaluation.error.copy()


@pytest.mark.parametrize("seed", range(CONFIGURATIONS))
def test_jacobians_are_minus_the_errors_derivatives(evaluation: Evaluation, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scatter_targets(evaluation, rng)
    model = evaluation.model
    q = random_configuration(model, evaluation.problem.start, rng, 0.7)
    error_at(evaluation, q)
    analytic = {
        term.name: np.eye(model.nv)
        if term.joint
        else evaluation.jacobian[evaluation.rows_of([term])].copy()
        for term in evaluation.terms
    }
    numeric = np.empty((evaluation.error.size, model.nv))
    for dof in range(model.nv):
        ends = []
        for sign in (1.0, -1.0):
            moved, direction = q.copy(), np.zeros(model.nv)
            direction[dof] = sign
            mujoco.mj_integratePos(model, moved, direction, STEP)
            ends.append(error_at(evaluation, moved))
        numeric[:, dof] = -(ends[0] - ends[1]) / (2 * STEP)
    for term in evaluation.terms:
        rows, expected = evaluation.rows_of([term]), analytic[term.name]
        weighed = np.ones(term.rows, dtype=bool)
        if term.joint:  # a posture leaves the floating base out by its weight
            weighed = term.weight > 0
        difference = (expected - numeric[rows])[weighed]
        assert np.abs(difference).max() < CENTRAL_DIFFERENCE, term.name


@pytest.mark.parametrize("seed", range(CONFIGURATIONS))
def test_feed_forward_is_the_errors_derivative_by_the_moving_target(
    evaluation: Evaluation, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scatter_targets(evaluation, rng)
    q = random_configuration(evaluation.model, evaluation.problem.start, rng, 0.7)
    twists = {}
    for term in evaluation.terms:
        if term.target_kind in ("pose", "point", "direction"):
            twists[term.name] = rng.normal(size=6)
            if term.target_kind == "direction":
                twists[term.name][:3] = 0.0
            evaluation.twist[term.name][:] = twists[term.name]
            evaluation.moving[evaluation.index[term.name]] = 1
    error_at(evaluation, q)
    feedforward = evaluation.feedforward.copy()
    targets = {name: target.copy() for name, target in evaluation.target.items()}
    ends = []
    for sign in (1.0, -1.0):
        for term in evaluation.terms:
            if term.name in twists:
                move_target(term, evaluation.target[term.name], targets, twists, sign * STEP)
        ends.append(error_at(evaluation, q))
    numeric = (ends[0] - ends[1]) / (2 * STEP)
    for term in evaluation.terms:
        if term.name in twists:
            rows = evaluation.rows_of([term])
            assert np.abs(feedforward[rows] - numeric[rows]).max() < CENTRAL_DIFFERENCE, term.name


def move_target(term, target, targets, twists, time: float) -> None:
    """Move a target along its twist for a time, from where it was."""
    twist, old = twists[term.name], targets[term.name]
    if term.target_kind == "pose":
        target[4:] = old[4:] + time * twist[:3]
        target[:4] = old[:4]
        turn = np.zeros(4)
        angle = np.linalg.norm(twist[3:])
        mujoco.mju_axisAngle2Quat(turn, twist[3:] / angle, angle * time)
        mujoco.mju_mulQuat(target[:4], turn, old[:4])
    elif term.target_kind == "point":
        target[:] = old + time * twist[:3]
    else:
        target[:] = old + time * np.cross(twist[3:], old)


def test_measured_errors_are_true_distances_and_angles(evaluation: Evaluation) -> None:
    rng = np.random.default_rng(0)
    scatter_targets(evaluation, rng)
    q = random_configuration(evaluation.model, evaluation.problem.start, rng, 0.7)
    error = error_at(evaluation, q)
    for name in ("frame", "second", "world"):
        term = evaluation.problem.term[name]
        assert isinstance(term, FrameTerm)
        position, matrix = term.frame.views(evaluation.data)
        pose, target = pose_of(matrix, position), evaluation.target[name]
        distance, angle = term.measure(evaluation.error_of(error, term))
        assert distance == pytest.approx(np.linalg.norm(target[4:] - pose[4:]), abs=1e-12)
        cosine = min(abs(target[:4] @ pose[:4]), 1.0)
        assert angle == pytest.approx(2 * np.arccos(cosine), abs=1e-7)
