"""What `rmrc check` says of frames that nothing moves, and of levels that λ slows down."""

import re
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc.runs.check import check

ARM = str(REPOSITORY / "scenes" / "planar_3r.xml")
HAND = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
REST = {"name": "rest", "type": "posture", "level": 1}
ROUNDED = 0.06
"""The share is said with two digits."""


def said_share(made: rmrc.Config) -> float | None:
    """Return the share of its gain that the lower level is said to decay at."""
    found = re.search(r"rest decays at ([\d.e-]+) % of its gain", "\n".join(check(made)))
    return float(found[1]) / 100 if found else None


@pytest.mark.parametrize(
    ("weight", "level", "damping", "strict"),
    [(0.01, 1, 0.01, False), (0.05, 1, 0.01, False), (1.0, 2, 0.01, False), (0.01, 1, 0.2, True)],
)
def test_the_share_of_the_gain_is_the_one_that_the_error_decays_at(
    weight: float, level: int, damping: float, strict: bool
) -> None:
    free = HAND | {"B": 0.0}  # it leaves the level below all that there is
    rest = REST | {"B": weight, "level": level, "target": [0.4, 0.9, 0.9], "gain": 2.0}
    made = config(
        ARM,
        [free, rest],
        damping={"lambda": damping},
        duration=2.0,
        priority="strict" if strict else "soft",
    )
    run = rmrc.solve(made)
    errors = np.linalg.norm(run.q - [0.4, 0.9, 0.9], axis=1)
    rate = -np.log(errors[-1] / errors[0]) / run.time[-1]
    assert said_share(made) == pytest.approx(rate / 2.0, rel=ROUNDED)


def test_a_level_without_weight_takes_nothing_from_the_one_below_it(engine: Any) -> None:
    rest = REST | {"target": [0.4, 0.9, 0.9]}
    given = config(ARM, [HAND | {"B": 0.0}, rest], priority="strict", engine=engine, duration=1.0)
    run = rmrc.solve(given)  # the native engine read what is not there
    assert run.summary["engine"] == engine
    assert np.linalg.norm(run.q[-1] - [0.4, 0.9, 0.9]) < 1e-3


def test_nothing_is_said_where_the_weight_is_larger_than_the_damping() -> None:
    assert said_share(config(ARM, [HAND, REST | {"B": 1.0}])) is None
    assert said_share(config(ARM, [HAND, REST | {"level": 0}])) is None


STILL = "no joint moves this"


@pytest.mark.parametrize(
    "task",
    [
        {"type": "frame", "frame": {"body": "world"}},
        {"type": "look_at", "frame": {"body": "world"}, "target": [1, 0, 0]},
        {"type": "axis_align", "frame": {"body": "world"}, "target": [1, 0, 0]},
        {"type": "relative_frame", "frame": {"site": "hand"}, "root": {"site": "hand"}},
    ],
    ids=lambda task: task["type"],
)
def test_a_frame_that_no_joint_moves_is_an_error(task: dict[str, Any]) -> None:
    with pytest.raises(rmrc.ConfigError, match=rf"tasks\[1\].frame: {STILL}"):
        check(config(ARM, [HAND, {"name": "still", **task}]))


def test_one_that_none_of_the_dofs_moves_is_said() -> None:
    link = {"name": "link", "type": "frame", "frame": {"body": "link1"}}
    said = "none of `dofs` moves link"
    assert not any(said in line for line in check(config(ARM, [link], dofs=["joint1", "joint2"])))
    assert any(said in line for line in check(config(ARM, [link], dofs=["joint2"])))
