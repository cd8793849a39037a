"""A configuration that changes while a controller runs: as one that was compiled so, from there."""

from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "level": 1}
LIMITS: dict[str, Any] = {
    "velocity": {"default": 1.5},
    "acceleration": {"default": 8.0},
    "collision": {"pairs": [["link2_arm", "link7"]], "d_min": 0.01, "detect": 0.2},
}
ENGINES = ("python", "native")
SAME = 1e-9
"""rad/s: the memory of a solver that starts anew changes nothing but rounding."""


def made(hand: dict[str, Any] = HAND, limits: dict[str, Any] = LIMITS) -> rmrc.Config:
    return config(PANDA, [hand, POSTURE], limits=limits, start="home", dt=0.002)


def on_the_way(engine: Any, **others: Any) -> tuple[rmrc.Controller, rmrc.Step]:
    controller = rmrc.Controller(rmrc.compile(made(**others)), engine)
    controller.set_target("hand", position=[0.4, 0.35, 0.35])
    steps = [controller.step() for _ in range(60)]
    return controller, steps[-1]


CHANGES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gain": ({"gain": 3.0}, {}),
    "weight": ({"B": {"position": 1.0, "orientation": 0.0}}, {}),
    "level": ({"level": 2}, {}),
    "velocity": ({}, {"velocity": {"default": 1.2, "joint1": 0.4}}),
    "acceleration": ({}, {"acceleration": {"default": 3.0}}),
    "position": ({}, {"position": {"margin": 0.2}}),
}


def after(controller: rmrc.Controller, count: int) -> rmrc.Step:
    """Return the last of so many steps."""
    return [controller.step() for _ in range(count)][-1]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("what", CHANGES)
def test_it_goes_on_as_if_it_had_been_compiled_so(engine: Any, what: str) -> None:
    task, limits = CHANGES[what]
    controller, last = on_the_way(engine)
    if task:
        controller.tune("hand", **task)
    if limits:
        controller.limit(**limits)
    fresh = rmrc.Controller(rmrc.compile(made(HAND | task, LIMITS | limits)), engine)
    fresh.reset(last.q, last.v)
    fresh.set_target("hand", position=[0.4, 0.35, 0.35])
    for _ in range(100):
        np.testing.assert_allclose(controller.step().v, fresh.step().v, rtol=0.0, atol=SAME)


@pytest.mark.parametrize("engine", ENGINES)
def test_no_change_makes_the_command_jump(engine: Any) -> None:
    controller, last = on_the_way(engine)
    before, most = last.v, 8.0 * controller.problem.dt + SAME
    for change in (
        lambda: controller.tune("hand", enabled=False),
        lambda: controller.tune("hand", enabled=True, gain=50.0),
        lambda: controller.limit(velocity={"default": 0.2}),
        lambda: controller.tune("posture", B=1.0, level=0),
    ):
        change()
        for _ in range(30):
            v = controller.step().v
            assert np.abs(v - before).max() <= most
            before = v
    assert np.abs(before).max() <= 0.2 + SAME


@pytest.mark.parametrize("engine", ENGINES)
def test_a_task_that_is_off_pulls_no_more_and_comes_back(engine: Any) -> None:
    controller, _ = on_the_way(engine)
    controller.tune("posture", enabled=False)
    controller.tune("hand", enabled=False)
    step = after(controller, 400)
    assert np.abs(step.v).max() < SAME
    controller.tune("hand", enabled=True)
    step = after(controller, 2500)
    assert step.error["hand"][0] < 1e-3
    assert controller.problem.config.tasks[0].model_dump()["B"] == made().tasks[0].model_dump()["B"]


def test_a_distance_changes_alone() -> None:
    controller, _ = on_the_way("native")
    controller.limit(collision={"d_min": 0.05})
    collision = controller.problem.config.limits.model_dump()["collision"]
    assert collision["d_min"] == 0.05
    assert collision["pairs"] == (("link2_arm", "link7"),)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda c: c.tune("hnad", gain=1.0), rmrc.ModelError, "did you mean 'hand'"),
        (lambda c: c.tune("hand", gian=1.0), rmrc.ConfigError, "gian.*did you mean 'gain'"),
        (lambda c: c.tune("hand", gain=-1.0), rmrc.ConfigError, "gain"),
        (lambda c: c.limit(velocty={}), rmrc.ConfigError, "velocty.*did you mean 'velocity'"),
        (lambda c: c.limit(velocity={"joint9": 1.0}), rmrc.ConfigError, "joint9"),
        (lambda c: c.limit(acceleration={"default": "much"}), rmrc.ConfigError, "acceleration"),
    ],
)
def test_a_wrong_change_is_refused_and_changes_nothing(
    change: Any, error: type[Exception], message: str
) -> None:
    controller, _ = on_the_way("native")
    twin, _ = on_the_way("native")
    with pytest.raises(error, match=message):
        change(controller)
    for _ in range(20):
        np.testing.assert_array_equal(controller.step().v, twin.step().v)


def test_what_has_no_weight_cannot_be_switched_off() -> None:
    freeze = {"name": "still", "type": "freeze", "joints": ["joint7"]}
    problem = rmrc.compile(config(PANDA, [HAND, freeze], start="home"))
    with pytest.raises(rmrc.ModelError, match="'still' is a freeze, which has no weight"):
        rmrc.Controller(problem).tune("still", enabled=False)


def test_what_was_set_stays() -> None:
    controller, _ = on_the_way("native")
    controller.set_twist("hand", [0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    controller.hold()
    controller.tune("hand", gain=4.0)
    step = after(controller, 100)
    assert not step.v.any()
    controller.resume()
    before = controller.pose("hand")[0, 3]
    for _ in range(200):
        controller.step()
    assert controller.pose("hand")[0, 3] - before > 0.01
