"""The second-order correction: a step along a curve keeps its distance, with or without a box."""

import numpy as np

import rmrc
from models import REPOSITORY, config
from rmrc.runs.measure import Measure

LIMITS = {"workspace": [{"frame": {"site": "hand"}, "normal": [0, 0, 1], "offset": 0.5}]}
# What the end of a step may lack, m, as the limit itself promises.
PASSED = 1e-6


def slide(velocity: str | dict[str, float]) -> tuple[float, float, list[float]]:
    """Press the hand on a plane and along it; return its way, the least room and the shares."""
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "axes": "world"}
    limits = {**LIMITS, "velocity": velocity}
    panda = str(REPOSITORY / "scenes" / "panda.xml")
    problem = rmrc.compile(
        config(panda, [hand | {"B": [1.0] * 3 + [0.0] * 3}], limits=limits, dt=0.02)
    )
    controller, measure = rmrc.Controller(problem), Measure(problem)
    begin = problem.term["hand"].target[4:]
    assert controller.set_target("hand", begin + [-0.2, 0.2, -0.5])
    rooms, shares = [], []
    for _ in range(60):
        step = controller.step()
        shares.append(controller.engine.share)
        data = controller.engine.evaluation.data
        rooms.append(measure.at(step.q, step.v, data)["workspace"].room)
    end = problem.forward(controller.q)["hand"][:3, 3]
    return float(np.linalg.norm((end - begin)[:2])), min(rooms), shares


def test_a_hand_in_touch_slides_at_full_speed() -> None:
    way, room, shares = slide({"default": 2.0})
    assert way > 0.25  # of 0.28
    assert room > -PASSED
    assert min(shares) == 1.0


def test_it_slides_without_a_limit_of_the_rates_too() -> None:
    way, room, _ = slide("off")
    assert way > 0.25
    assert room > -PASSED
