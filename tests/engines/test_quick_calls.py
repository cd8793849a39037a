"""The calls of the loop that C++ takes: as a method of Python's in all that can be seen of them."""

import copy
import gc
import inspect
import sys
import time
import typing
import weakref
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc import Controller, Problem, Status, Step

HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
POSITION, QUATERNION = np.array([0.4, 0.1, 0.5]), np.array([0.0, 1.0, 0.0, 0.0])
ROOM = 512 * 1024
"""Bytes by which a process may grow over 20,000 steps: one of them a step would be more."""


@pytest.fixture(scope="module")
def problem() -> Problem:
    return rmrc.compile(config(str(REPOSITORY / "scenes" / "panda.xml"), [HAND], dt=0.01))


@pytest.fixture
def controller(problem: Problem) -> Controller:
    made = Controller(problem)
    if made.stepper is None:
        pytest.skip("the native extension is not built")
    return made


def test_all_forms_of_a_call_are_the_same(controller: Controller) -> None:
    forms: list[tuple[tuple[Any, ...], dict[str, Any]]] = [
        (("hand", POSITION, QUATERNION), {}),
        (("hand",), {"quaternion": QUATERNION, "position": POSITION}),
        ((), {"name": "hand", "position": POSITION, "quaternion": QUATERNION, "q": None}),
        (("hand", POSITION.tolist(), tuple(QUATERNION)), {"velocity": None}),
        (("hand", np.repeat(POSITION, 2)[::2], QUATERNION.astype(np.float32)), {}),
        (("hand", POSITION.astype(">f8"), QUATERNION), {}),
    ]
    found = []
    for positional, named in forms:
        controller.reset()
        assert controller.set_target(*positional, **named)
        q = controller.q
        steps = [
            controller.step(), controller.step(None, 0.01), controller.step(dt=0.01, q=None),
            controller.step(q.tolist()), controller.step(q, 0.01, None, 0.0),
        ]  # fmt: skip
        assert not any(step.flags & {Status.INVALID_INPUT} for step in steps)
        found.append([np.concatenate([step.v, step.q]) for step in steps])
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_what_does_not_fit_is_an_error_of_pythons(controller: Controller) -> None:
    call: Any = controller
    for wrong in (
        lambda: call.step(1, 2, 3, 4, 5),
        lambda: call.step(None, q=None),
        lambda: call.step(speed=1.0),
        lambda: call.set_target(),
        lambda: call.set_target("hand", None, None, None, None),
        lambda: call.set_target("hand", POSITION, position=POSITION),
        lambda: call.set_target(["hand"], POSITION),
        lambda: type(call).step(),
    ):
        with pytest.raises(TypeError):
            wrong()
    with pytest.raises(rmrc.ModelError, match="hand"):
        call.set_target("hnad", POSITION)


def test_what_is_refused_is_said_by_the_next_step_alone(controller: Controller) -> None:
    for bad in (POSITION * np.nan, POSITION[:2], "here"):
        assert not controller.set_target("hand", bad)  # type: ignore[arg-type]
        assert (controller.step().status, controller.failures) == (Status.INVALID_INPUT, 1)
        assert controller.step(np.zeros(2)).status == Status.INVALID_INPUT
        assert controller.failures == 2
        assert Status.INVALID_INPUT not in controller.step().flags
        assert controller.failures == 0


def test_it_is_a_method(controller: Controller) -> None:
    assert list(inspect.signature(controller.step).parameters) == ["q", "dt", "v", "age"]
    assert Controller.step.__name__ == "step"
    assert (Controller.set_target.__doc__ or "").startswith("Set a task's target")

    class Counting(Controller):
        steps = 0

        def step(self, *args: Any, **kwargs: Any) -> Step:
            self.steps += 1
            return super().step(*args, **kwargs)

    counting = Counting(controller.problem)
    np.testing.assert_array_equal(counting.step().v, controller.step().v)
    assert counting.steps == 1
    step, alive = Controller(controller.problem).step, weakref.ref(counting)
    assert step().status == Status.OK  # it keeps its controller
    gc.disable()
    try:
        del counting
        assert alive() is None  # and a controller is no cycle
    finally:
        gc.enable()


def test_a_step_is_what_it_was(controller: Controller) -> None:
    controller.set_target("hand", POSITION)
    step = controller.step()
    v, q = step.v.copy(), step.q.copy()
    solution, moment = step.solution, step.moment
    for _ in range(3):
        controller.step()
    assert isinstance(step, Step)
    assert step.v is step.v
    assert step.solution is solution
    assert step.moment is moment
    np.testing.assert_array_equal([*step.v, *step.q], [*v, *q])
    np.testing.assert_array_equal(solution.v, v[controller.problem.dofs])


def test_a_name_that_is_not_interned_has_the_deadline_of_its_own_step() -> None:
    options = {"solver": {"deadline": 1e5}, "dt": 0.01}
    scene = str(REPOSITORY / "scenes" / "panda.xml")
    controller = Controller(rmrc.compile(config(scene, [HAND], **options)))
    controller.step()
    time.sleep(0.15)  # the deadline of that one is over
    named: dict[str, Any] = {"".join(("d", "t")): 0.01}
    assert controller.step(**named).status is not Status.DEADLINE


def test_what_python_asks_of_a_method_and_of_an_object(controller: Controller) -> None:
    assert typing.get_type_hints(Controller.step)["return"] is Step
    step = controller.step()
    assert copy.copy(step).v is step.v


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells the size")
def test_steps_leave_nothing_behind(controller: Controller) -> None:
    def size() -> int:
        with open("/proc/self/statm") as numbers:
            return int(numbers.read().split()[1]) * 4096

    def walk(steps: int) -> None:
        for k in range(steps):
            controller.set_target("hand", POSITION, quaternion=QUATERNION)
            step = controller.step(dt=0.01)
            assert step.v.size == 7
            if k % 100 == 0:
                assert step.moment.q.size == step.q.size == step.solution.v.size

    walk(2_000)
    counts = [sys.getrefcount(each) for each in (controller.engine, POSITION, QUATERNION)]
    before = size()
    walk(20_000)
    assert size() - before < ROOM
    assert counts == [sys.getrefcount(e) for e in (controller.engine, POSITION, QUATERNION)]
