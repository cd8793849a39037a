"""Values set from outside: which paths there are, and what wrong ones are told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rmrc.config.load import load, parse_override
from rmrc.errors import ConfigError

GOLDEN = Path(__file__).parents[1] / "text" / "golden" / "config"
CONFIG = """\
scene: arm.xml
tasks:
  - {name: hand, type: frame, frame: {site: hand}}
  - {use: stacks/reach.yaml, with: {frame: {site: hand}, side: _r}}
limits: {acceleration: off}
targets:
  hand: {path: pose, position: [1.0, 1.0, 0.0]}
"""


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A file beside the golden scene and stacks."""
    for name in ("arm.xml", "stacks"):
        (tmp_path / name).symlink_to(GOLDEN / name)
    (tmp_path / "run.yaml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return Path("run.yaml")


@pytest.mark.parametrize(
    ("text", "override"),
    [
        ("solver.backend=osqp", ("solver.backend", "osqp")),
        ("damping.lambda=1e-6", ("damping.lambda", 1e-6)),
        ("tasks[0].gain=5", ("tasks[0].gain", 5)),
        ("tasks.left-hand.B=[1, 2]", ("tasks.left-hand.B", [1, 2])),
        ("start={shoulder: 0.1}", ("start", {"shoulder": 0.1})),
        ("limits.velocity=off", ("limits.velocity", "off")),
        ("start=", ("start", None)),
        ("scene=a=b.xml", ("scene", "a=b.xml")),
    ],
)
def test_an_option_is_a_path_and_a_yaml_value(text, override):
    assert parse_override(text) == override


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("solver.backend", "write it as in --set solver.backend=osqp"),
        ("=5", "write it as in --set solver.backend=osqp"),
        ("solver..backend=osqp", "write it as in --set solver.backend=osqp"),
        ("tasks[x].B=1", "write it as in --set solver.backend=osqp"),
        (
            "dofs=[a, b",
            "this list is missing a comma or its closing ]; "
            "text with { } [ ] in it goes into quotes",
        ),
        (
            "scene=!!python/name:os.x",
            "tags such as !!python/object have no meaning here; remove it",
        ),
    ],
)
def test_an_option_that_is_none_is_told_how(text, why):
    with pytest.raises(ConfigError) as caught:
        parse_override(text)
    assert str(caught.value) == f"--set {text}: {why}"


def test_overrides_reach_every_value(path):
    loaded: Any = load(
        path,
        {
            "dt": 0.01,
            "solver.backend": "osqp",
            "tasks[0].gain": np.float64(5.0),
            "tasks.hand_r.B": np.arange(6),
            "limits.velocity.elbow": 1.5,
            "limits.acceleration": {"default": 3.0},
            "targets.hand.position[2]": 0.5,
            "metric": np.eye(2),
        },
    )
    assert loaded.dt == 0.01
    assert loaded.solver.backend == "osqp"
    assert loaded.tasks[0].gain == 5.0
    assert loaded.tasks[1].B == (0, 1, 2, 3, 4, 5)
    assert loaded.limits.velocity.default == 2.0
    assert loaded.limits.velocity.named == {"elbow": 1.5}
    assert loaded.limits.acceleration.default == 3.0
    assert loaded.targets["hand"].position == (1.0, 1.0, 0.5)
    assert loaded.metric == ((1.0, 0.0), (0.0, 1.0))


def test_a_file_is_not_changed_by_an_override(path):
    load(path, {"dt": 0.01})
    assert load(path).dt == 0.002


def test_paths_that_lead_nowhere_say_why(path):
    overrides = {
        "tasks.hnad.B": 1,
        "tasks[2].B": 1,
        "targets.hand.position.x": 1,
        "limits.acceleration.elbow": 1,
        "a..b": 1,
    }
    with pytest.raises(ConfigError) as caught:
        load(path, overrides)
    assert str(caught.value).splitlines() == [
        "--set a..b=1: a path is written as in solver.backend or tasks[0].gain",
        "--set limits.acceleration.elbow=1: "
        "'limits.acceleration' is the text 'off', and nothing is inside it",
        "--set targets.hand.position.x=1: no item of 'targets.hand.position' named 'x'; "
        "there is no item of 'targets.hand.position' at all",
        "--set tasks.hnad.B=1: no item of 'tasks' named 'hnad'; did you mean 'hand'? "
        "There is: hand, hand_r",
        "--set tasks[2].B=1: 'tasks' has 2 items, the first of them [0]",
    ]


def test_a_path_of_any_length_is_refused(path):
    with pytest.raises(ConfigError, match="at most 50 levels deep"):
        load(path, {".".join(["targets"] * 5000): 1})


def test_a_wrong_value_is_told_with_its_option(path):
    with pytest.raises(ConfigError) as caught:
        load(path, {"solver.bakcend": "osqp", "limits.velocity.elbw": 1, "tasks.hand.gain": -1})
    assert str(caught.value).splitlines() == [
        "--set limits.velocity.elbw=1: "
        "no joint named 'elbw'; did you mean 'elbow'? There is: shoulder, elbow "
        "(`rmrc inspect` lists all names)",
        "--set solver.bakcend=osqp: "
        "no key named 'bakcend'; did you mean 'backend'? "
        "There is: backend, max_iter, deadline, tolerance",
        "--set tasks.hand.gain=-1: this must be greater than 0, not -1",
    ]
