"""Errors in the units of what they are of, and of the step that they are said to be of."""

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

SCENE = str(REPOSITORY / "scenes" / "mobile_arm.xml")


def test_a_posture_tells_metres_from_radians(engine: str) -> None:
    tasks = [{"name": "posture", "type": "posture", "target": {"base_x": 3.0, "base_yaw": 0.4}}]
    problem = rmrc.compile(config(SCENE, tasks))
    start, term = problem.start, problem.term["posture"]
    model = problem.model
    step = rmrc.Controller(problem, engine).step()  # type: ignore
    away = [
        abs(v - start[model.joint(n).qposadr[0]]) for n, v in (("base_x", 3.0), ("base_yaw", 0.4))
    ]
    assert term.units == ("m", "rad")
    assert step.error["posture"] == pytest.approx(away)
    account = step.explain().tasks[0]
    assert account.units == ("m", "rad")
    assert account.asked == pytest.approx([10.0 * each for each in away])


def test_a_posture_of_hinges_is_in_radians() -> None:
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    problem = rmrc.compile(config(scene, [{"name": "posture", "type": "posture"}]))
    assert problem.term["posture"].units == ("rad",)


def test_the_error_of_rates_is_that_of_the_step_itself(engine: str) -> None:
    tasks = [{"name": "drive", "type": "velocity", "target": {"base_x": 0.5, "base_yaw": 0.2}}]
    limits = {"acceleration": {"default": 5.0}}
    problem = rmrc.compile(config(SCENE, tasks, dt=0.01, limits=limits))
    controller = rmrc.Controller(problem, engine)  # type: ignore
    x, yaw = (problem.model.joint(name).dofadr[0] for name in ("base_x", "base_yaw"))
    assert problem.term["drive"].units == ("m/s", "rad/s")
    for _ in range(5):
        step = controller.step()
        left = np.abs([0.5 - step.v[x], 0.2 - step.v[yaw]])
        assert step.error["drive"] == pytest.approx(left, abs=1e-12)
