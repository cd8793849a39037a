"""What can be copied and pickled, and what cannot be written to."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY

CONFIGS = ("panda_line", "panda_obstacle", "dual_arm_collision")
SAME = 1e-9
"""An engine that is built anew evaluates the same numbers again, but for their last bits."""


def stepped(name: str, engine: Any, steps: int = 150) -> tuple[rmrc.Controller, list[rmrc.Step]]:
    """Return a controller and its steps towards targets that are far away and move."""
    problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / f"{name}.yaml"))
    controller = rmrc.Controller(problem, engine)
    frame = next(term.name for term in problem.terms if term.target_kind == "pose")
    at = controller.engine.evaluation.target[frame][4:] + [0.3, 0.2, -0.3]
    controller.set_target(frame, at, velocity=[0.1, 0.0, 0.0, 0.0, 0.0, 0.1])
    return controller, [controller.step() for _ in range(steps)]


def alike(step: rmrc.Step, other: rmrc.Step) -> None:
    """Hold a step to be the same as another one."""
    assert np.array_equal(step.v, other.v)
    assert np.array_equal(step.q, other.q)
    assert step.flags == other.flags
    assert step.solution.kkt == other.solution.kkt
    assert {k: v.tolist() for k, v in step.error.items()} == {
        k: v.tolist() for k, v in other.error.items()
    }
    one, two = step.explain(), other.explain()
    assert [str(b).split(":")[0] for b in one.bindings] == [
        str(b).split(":")[0] for b in two.bindings
    ]
    assert [b.bound for b in one.bindings] == pytest.approx(
        [b.bound for b in two.bindings], rel=SAME, abs=SAME
    )
    assert one.share == two.share
    for task, same in zip(one.tasks, two.tasks, strict=True):
        assert task.got == pytest.approx(same.got, rel=SAME, abs=SAME)


@pytest.mark.parametrize("name", CONFIGS)
def test_a_step_is_the_same_after_pickling_and_copying(name: str, engine: Any) -> None:
    _, steps = stepped(name, engine)
    for step in (steps[0], steps[-1]):
        again = pickle.loads(pickle.dumps(step))
        alike(again, step)
        alike(pickle.loads(pickle.dumps(again)), step)
        alike(copy.deepcopy(step), step)
        alike(copy.copy(step), step)


def test_what_was_wrong_with_an_input_goes_along(engine: Any) -> None:
    controller, _ = stepped("panda_line", engine, 3)
    step = controller.step(np.full(7, np.nan))
    again = pickle.loads(pickle.dumps(step))
    assert again.reasons == step.reasons
    assert "q[0] is nan" in again.reasons[0]


def test_a_deep_copy_has_arrays_of_its_own(engine: Any) -> None:
    _, steps = stepped("panda_line", engine, 3)
    other = copy.deepcopy(steps[-1])
    other.v[:] = other.q[:] = 0.0
    assert steps[-1].v.any()
    assert steps[-1].q.any()


def test_steps_of_a_problem_share_an_engine_after_pickling() -> None:
    _, steps = stepped("panda_line", "auto", 3)
    one, two = pickle.loads(pickle.dumps(steps[:2]))
    assert one.moment.engine is two.moment.engine


def test_another_process_reads_a_step(tmp_path: Path) -> None:
    _, steps = stepped("panda_obstacle", "auto")
    (tmp_path / "step").write_bytes(pickle.dumps(steps[-1]))
    program = (
        "import pickle, sys; step = pickle.load(open(sys.argv[1], 'rb'));"
        "print(step.status.name, step.v.tolist(), *step.explain().bindings, sep='\\n')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "step")], capture_output=True, text=True
    )
    assert done.stdout.splitlines()[:2] == [steps[-1].status.name, str(steps[-1].v.tolist())]
    assert len(done.stdout.splitlines()) == 2 + len(steps[-1].explain().bindings)


@pytest.mark.parametrize("action", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_controller_refuses_with_a_sentence(action: Any, engine: Any) -> None:
    problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / "panda_line.yaml"))
    for made in (rmrc.Controller(problem, engine), rmrc.BatchController(problem, 2, engine=engine)):
        with pytest.raises(rmrc.RmrcError, match=r"cannot be copied or pickled.*Make another"):
            action(made)


@pytest.mark.parametrize("remake", [lambda problem: problem, copy.deepcopy, pickle.dumps])
def test_start_and_box_cannot_be_written_to(remake: Any) -> None:
    problem = remake(rmrc.compile(rmrc.load(REPOSITORY / "configs" / "panda_line.yaml")))
    problem = pickle.loads(problem) if isinstance(problem, bytes) else problem
    box = problem.box
    for array in (problem.start, problem.metric, box.lower, box.upper, box.velocity, box.step):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
