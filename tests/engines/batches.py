"""Controllers in batches, and inputs for them."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config
from rmrc import BatchController, Problem

Array = NDArray[np.float64]

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "level": 1}

native = pytest.mark.skipif(
    bool(BatchController(rmrc.compile(config(PANDA, [HAND])), 1).notices),
    reason="the native extension is not built",
)


def panda(*tasks: dict[str, Any], **others: Any) -> Problem:
    return rmrc.compile(config(PANDA, [HAND, POSTURE, *tasks], dt=0.01, **others))


def scattered(problem: Problem, n: int, rng: np.random.Generator, far: float) -> dict[str, Array]:
    """Return targets for n elements, each up to so far away; every seventh row is not valid."""
    found = {}
    for name, term in problem.term.items():
        if term.target_kind == "pose":
            turned = term.target[:4] + 0.2 * rng.normal(size=(n, 4))
            found[name] = np.hstack([term.target[4:] + rng.uniform(-far, far, (n, 3)), turned])
            found[name][6::7, 3:] = 0.0
        elif term.target_kind == "point":
            found[name] = term.target + rng.uniform(-far, far, (n, 3))
            found[name][6::7, 1] = np.inf
    return found
