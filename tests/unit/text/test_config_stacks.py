"""Stacks: parameters, overrides and limits, and where each value then comes from."""

from typing import Any

import pytest

from rmrc.config.load import load
from rmrc.errors import ConfigError

SCENE = """\
<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="shoulder"/>
      <geom name="upper" size="0.1"/>
      <site name="hand" pos="1 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""
REACH = """\
parameters:
  frame: null
  name: hand
  gain: 20.0
  B: {position: 1.0, orientation: 0.5}
tasks:
  - {name: $name, type: frame, frame: $frame, gain: $gain, B: $B}
  - {name: "${name}_rest", type: posture, level: 1}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a scene and a stack, in it."""
    (tmp_path / "arm.xml").write_text(SCENE)
    (tmp_path / "stacks").mkdir()
    (tmp_path / "stacks" / "reach.yaml").write_text(REACH)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def config(text) -> Any:
    """Load a configuration with these tasks and what follows them."""
    with open("run.yaml", "w") as file:
        file.write(f"scene: arm.xml\ntasks:\n{text}")
    return load("run.yaml")


def stack(text):
    """Write a second stack."""
    with open("stacks/other.yaml", "w") as file:
        file.write(text)


def test_tasks_come_in_place_of_the_use(folder):
    tasks = config(
        "  - {name: before, type: smooth}\n"
        "  - {use: stacks/reach.yaml, with: {frame: {site: hand}}}\n"
        "  - {name: after, type: smooth}\n"
    ).tasks
    assert [task.name for task in tasks] == ["before", "hand", "hand_rest", "after"]


def test_a_parameter_is_a_value_of_any_type_or_part_of_a_text(folder):
    tasks = config(
        "  - use: stacks/reach.yaml\n"
        "    with: {frame: {body: upper}, name: left, gain: deadbeat, B: [1, 1, 1, 0, 0, 0]}\n"
    ).tasks
    assert [task.name for task in tasks] == ["left", "left_rest"]
    assert tasks[0].frame.name == "upper"
    assert tasks[0].gain == "deadbeat"
    assert tasks[0].B == (1, 1, 1, 0, 0, 0)


def test_defaults_hold_where_with_says_nothing(folder):
    hand = config("  - {use: stacks/reach.yaml, with: {frame: {site: hand}}}\n").tasks[0]
    assert hand.gain == 20.0
    assert hand.B.orientation == 0.5


def test_numbers_keys_and_dollars_in_text(folder):
    stack(
        "parameters: {side: 2, joint: shoulder}\n"
        "tasks:\n"
        "  - {name: 'rest${side}', type: posture, target: {'${joint}': 0.1}}\n"
        "limits: {velocity: {'${joint}': 1.5}}\n"
    )
    loaded = config("  - use: stacks/other.yaml\n")
    assert loaded.tasks[0].name == "rest2"
    assert loaded.tasks[0].target == {"shoulder": 0.1}
    assert loaded.limits.velocity.named == {"shoulder": 1.5}
    stack("tasks:\n  - {name: $$rest, type: posture}\n")
    with pytest.raises(ConfigError, match=r"'\$rest' is no name"):
        config("  - use: stacks/other.yaml\n")


def test_a_stack_used_twice_is_two(folder):
    tasks = config(
        "  - {use: stacks/reach.yaml, with: {frame: {site: hand}}}\n"
        "  - {use: stacks/reach.yaml, with: {frame: {body: upper}, name: tool}}\n"
    ).tasks
    assert [task.name for task in tasks] == ["hand", "hand_rest", "tool", "tool_rest"]
    assert tasks[0].frame.name == "hand"


def test_override_merges_into_the_task_of_a_name(folder):
    loaded = config(
        "  - use: stacks/reach.yaml\n"
        "    with: {frame: {site: hand}, name: left}\n"
        "    override:\n"
        "      left: {B: {position: 7.0}, clamp: {position: 0.1}}\n"
        "      left_rest: {level: 3}\n"
        "      limits: {velocity: {default: 0.5}}\n"
    )
    left, rest = loaded.tasks
    assert (left.B.position, left.B.orientation) == (7.0, 0.5)
    assert left.clamp.position == 0.1
    assert rest.level == 3
    assert loaded.limits.velocity.default == 0.5


def test_the_configuration_own_limits_win(folder):
    stack("limits:\n  velocity: {default: 2.0, shoulder: 1.0}\n  position: {margin: 0.1}\n")
    limits = config("  - use: stacks/other.yaml\n  - {name: rest, type: posture}\n").limits
    assert (limits.velocity.default, limits.velocity.named) == (2.0, {"shoulder": 1.0})
    assert limits.position.margin == 0.1
    limits = config(
        "  - use: stacks/other.yaml\n  - {name: rest, type: posture}\n"
        "limits: {velocity: {default: 3.0}, position: off}\n"
    ).limits
    assert (limits.velocity.default, limits.velocity.named) == (3.0, {"shoulder": 1.0})
    assert limits.position == "off"


@pytest.mark.parametrize(
    ("own", "agree"),
    [("", False), ("limits: {velocity: {shoulder: 1}}\n", False)]
    + [(f"limits: {{velocity: {own}}}\n", True) for own in ("off", "{default: 3.0}")],
)
def test_stacks_that_disagree_need_the_configuration(folder, own, agree):
    (folder / "stacks" / "slow.yaml").write_text("limits: {velocity: {default: 1.0}}\n")
    stack("limits: {velocity: {default: 2.0}}\ntasks: [{name: rest, type: posture}]\n")
    text = f"  - use: stacks/slow.yaml\n  - use: stacks/other.yaml\n{own}"
    if agree:
        config(text)
    else:
        with pytest.raises(ConfigError, match=r"other.yaml:1:30: .* 1.0 at stacks/slow.yaml:1"):
            config(text)


def test_values_keep_the_place_where_they_were_written(folder):
    loaded = config(
        "  - use: stacks/reach.yaml\n"
        "    with:\n"
        "      frame: {site: hand}\n"
        "    override: {hand: {level: 2}}\n"
    )
    places = {
        key: str(loaded.place(("tasks", 0, *key)))
        for key in ((), ("name",), ("frame", "site"), ("gain",), ("B", "position"), ("level",))
    }
    assert places == {
        (): "stacks/reach.yaml:7",
        ("name",): "stacks/reach.yaml:3",
        ("frame", "site"): "run.yaml:5",
        ("gain",): "stacks/reach.yaml:4",
        ("B", "position"): "stacks/reach.yaml:5",
        ("level",): "run.yaml:6",
    }


@pytest.mark.parametrize(
    ("use", "value"),
    [
        ("[{}]".format(", ".join(["$x"] * 300)), [1] * 300),
        ("'{}'".format("${x}" * 2000), "y" * 3000),
    ],
    ids=["values", "text"],
)
def test_a_stack_that_grows_without_bound_is_refused(folder, use, value):
    stack(f"parameters: {{x: null}}\ntasks: [{{name: a, type: posture, B: {use}}}]\n")
    with pytest.raises(ConfigError, match="with its stacks a configuration has at most"):
        config(f"  - {{use: stacks/other.yaml, with: {{x: {value}}}}}\n")


def test_a_stack_that_cannot_be_read_is_one_mistake_however_often_it_is_used(folder):
    stack("tasks: [\n")
    with pytest.raises(ConfigError) as caught:
        config("  - use: stacks/other.yaml\n  - use: ./stacks/../stacks/other.yaml\n" * 20)
    assert len(caught.value.mistakes) == 1


def test_a_section_without_content_is_a_mistake(folder):
    stack("parameters:\ntasks: []\n")
    with pytest.raises(ConfigError, match="'parameters' wants keys and values, not an empty value"):
        config("  - use: stacks/other.yaml\n")
