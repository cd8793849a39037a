"""Robots of others, out of reach of their targets in every way of asking: none of them shakes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import MENAGERIE, config
from soaking.shaking import Shaking

SECONDS = 6.0
DT = 0.002
AWAY = (0.3, 1.0, 30.0)
"""m to targets in random directions: at the edge of what is reached, and beyond."""
LAST = 1.0
"""s at the end, in which no rate may change its sign twice."""
MOVES = 1e-3
"""rad/s; a slower rate has no sign."""
POINT = {"position": 1.0, "orientation": 0.0}
ACCELERATION = {"acceleration": {"default": 10.0}}
WAYS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "soft": ({}, {}),
    "a point": ({"B": POINT}, {}),
    "in the world's axes": ({"axes": "world"}, {}),
    "deadbeat": ({"gain": "deadbeat"}, {}),
    "strict": ({}, {"priority": "strict"}),
    "hard point": ({"hard": True, "B": POINT}, {}),
    "direction of a point": ({"preserve": "direction", "B": POINT}, {}),
    "acceleration": ({}, {"limits": ACCELERATION}),
    "strict, acceleration": ({}, {"priority": "strict", "limits": ACCELERATION}),
    "sigma_min": ({}, {"damping": {"adapt": "sigma_min"}}),
    "manipulability": ({}, {"damping": {"adapt": "manipulability"}}),
    "error": ({}, {"damping": {"adapt": "error"}}),
}
SHAKING = {
    ("panda", "strict"),
    ("shadow", "hard point"),
    *((robot, "direction of a point") for robot in ("panda", "ur5e", "iiwa", "aloha", "shadow")),
}
"""What still shakes on its way, for more than 0.1 s: near a singularity the null space that lower
levels move in turns faster than they move."""


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("robot", MENAGERIE)
def test_none_shakes(request: pytest.FixtureRequest, menagerie: Path, robot: str, way: str) -> None:
    if (robot, way) in SHAKING:
        request.applymarker(pytest.mark.xfail(strict=True, reason="the null space turns too fast"))
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    file, frame = MENAGERIE[robot]
    own, others = WAYS[way]
    tasks = [
        {"name": "hand", "type": "frame", "frame": frame, **own},
        {"name": "posture", "type": "posture", "level": 1, "B": 0.01},
    ]
    problem = rmrc.compile(config(str(menagerie / f"{file}.xml"), tasks, dt=DT, **others))
    rng = np.random.default_rng(0)
    for away in AWAY:
        controller = rmrc.Controller(problem, "native")
        direction = rng.normal(size=3)
        place = problem.forward(controller.q)["hand"][:3, 3]
        place += away * direction / np.linalg.norm(direction)
        assert controller.set_target("hand", position=place)
        shaking, rates = Shaking(problem.dofs.size), []
        for _ in range(round(SECONDS / DT)):
            step = controller.step()
            rates.append(step.v[problem.dofs])
            assert not shaking.update(rates[-1], DT)
        for rate in np.array(rates)[-round(LAST / DT) :].T:
            signs = np.sign(rate[np.abs(rate) > MOVES])
            assert np.count_nonzero(np.diff(signs)) <= 1
