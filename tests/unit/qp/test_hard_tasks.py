"""Tasks marked hard: rows in place of a cost."""

from pathlib import Path

import numpy as np
import pytest
from constrained_models import EXACT, compiled, equalities_of, panda

import rmrc
from rmrc.problem.evaluation import Evaluation
from rmrc.qp.assemble import Assembly


def test_a_hard_task_on_the_joints_is_rows_of_the_identity(repository: Path) -> None:
    B = [0, 1, 0, 2, 0, 0, 0]
    task = {"name": "posture", "type": "posture", "B": B, "gain": 2.0, "target": [0.1] * 7}
    problem = compiled(panda({**task, "hard": True}), repository)
    found = equalities_of(problem)
    v = 2.0 * (0.1 - problem.start)
    assert found.matrix.shape == (2, 7)
    np.testing.assert_array_equal(found.matrix[:, [0, 2, 4, 5, 6]], 0.0)
    np.testing.assert_allclose(found.matrix @ v, found.right, atol=EXACT)


def test_a_hard_tasks_rate_is_clamped_as_a_costs_is(repository: Path) -> None:
    hand = {"name": "hand", "type": "com", "gain": 10.0, "clamp": 0.01, "hard": True}
    problem = compiled(panda(hand), repository)
    evaluation = Evaluation(problem)
    assembly = Assembly(problem, evaluation)
    evaluation.target["hand"][0] += 0.5
    evaluation.update(problem.start)
    evaluation.evaluate()
    assembly.assemble(problem.start, problem.dt)
    found = assembly.equalities()
    assert found is not None
    assert np.linalg.norm(found.right) == pytest.approx(0.1, abs=EXACT)


def test_a_hard_task_has_no_part_in_the_cost(repository: Path) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "B": 3.0}
    full = np.diag([0.0, 2.0, 0.0, 5.0, 0.0, 0.0, 0.0]).tolist()
    hard = [
        {"name": "com", "type": "com", "B": 100.0, "hard": True},
        {"name": "posture", "type": "posture", "B": full, "hard": True},
        {"name": "speed", "type": "velocity", "target": {"joint1": 0.1}, "hard": True},
    ]
    programs = []
    for tasks in ([hand], [hand, *hard]):
        problem = compiled(panda(*tasks), repository)
        evaluation = Evaluation(problem)
        assembly = Assembly(problem, evaluation)
        evaluation.target["hand"][4:] += 0.1
        evaluation.update(problem.start)
        evaluation.evaluate()
        assembly.assemble(problem.start, problem.dt)
        programs.append((assembly.qp.H.copy(), assembly.qp.g.copy(), assembly.sigma_min()))
        assert len(assembly.levels()) == 2  # the hand, and what picks among equal motions
    for alone, beside in zip(*programs, strict=True):
        np.testing.assert_allclose(beside, alone, atol=EXACT)


WITHOUT = {
    "smooth": {},
    "kinetic_energy": {},
    "centering": {},
    "freeze": {"joints": ["joint1"]},
    "manipulability": {"frame": {"site": "hand"}},
    "clearance": {"pairs": [["hand", "floor"]]},
}


@pytest.mark.parametrize("kind", WITHOUT)
def test_what_has_no_error_cannot_be_hard(repository: Path, tmp_path: Path, kind: str) -> None:
    values = "".join(f", {key}: {value}" for key, value in WITHOUT[kind].items())
    path = tmp_path / "config.yaml"
    path.write_text(
        f"scene: {repository}/scenes/panda.xml\n"
        f"tasks:\n  - {{name: task, type: {kind}, hard: true{values}}}\n"
    )
    with pytest.raises(rmrc.ConfigError, match=r":3:\d+: no key named 'hard'; there is: name"):
        rmrc.load(path)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("type: frame, frame: {site: hand}, hard: true, level: 1", "leave `level` out"),
        ("type: loop, level: 1", "leave `level` out"),
        ("type: coupling, coefficients: {joint1: 1}, level: 2", "leave `level` out"),
        ("type: frame, frame: {site: hand}, hard: true, preserve: direction", "no cost to replace"),
        ("type: com, hard: 1", "true or false is wanted here"),
    ],
)
def test_what_contradicts_hard_is_a_mistake(
    repository: Path, tmp_path: Path, values: str, message: str
) -> None:
    path = tmp_path / "config.yaml"
    scene = repository / "scenes" / "panda.xml"
    path.write_text(f"scene: {scene}\ntasks:\n  - {{name: task, {values}}}\n")
    with pytest.raises(rmrc.ConfigError, match=message):
        rmrc.load(path)


def test_a_closed_form_refuses_hard_tasks(repository: Path) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    coupling = {"name": "pair", "type": "coupling", "coefficients": {"joint1": 1.0}}
    problem = compiled(panda(hand, coupling, method="pinv"), repository)
    with pytest.raises(rmrc.ConfigError, match="no place for hard tasks: pair"):
        rmrc.Controller(problem)
