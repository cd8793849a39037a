"""Loading: every mistake at once, places for later ones, origins, and Python's own way in."""

import copy
import pickle
from pathlib import Path
from typing import Any

import pytest

import rmrc
from rmrc.config.load import load, show
from rmrc.errors import ConfigError
from rmrc.text.document import Document
from rmrc.text.mistakes import MOST_MISTAKES, Mistake, config_error

GOLDEN = Path(__file__).parents[1] / "text" / "golden" / "config"
CONFIG = """\
scene: arm.xml
start: {shoulder: 0.1}
damping: {lambda: 1e-6}
tasks:
  - use: stacks/reach.yaml
    with: {frame: {site: hand}}
  - name: rest
    type: posture
    B: [1, 2]
targets:
  hand:
    path: waypoints
    through:
      - {position: [1.0, 1.0, 0.0], quaternion: [2, 0, 0, 0]}
      - position: [1, 0.5, 0]
    duration: 2
"""


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A file beside the golden scene and stacks."""
    for name in ("arm.xml", "stacks"):
        (tmp_path / name).symlink_to(GOLDEN / name)
    (tmp_path / "run.yaml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return Path("run.yaml")


def refusal(make) -> ConfigError:
    """Return the error of what must not work."""
    with pytest.raises(ConfigError) as caught:
        make()
    return caught.value


def test_mistakes_of_every_kind_come_at_once(path):
    path.write_text(
        CONFIG.replace("shoulder", "shuolder")
        .replace("lambda", "lamda")
        .replace("site: hand", "site: hnad")
        .replace("stacks/reach", "stacks/reahc")
        .replace("B: [1, 2]", "B: [1, -2]")
        .replace("path: waypoints", "path: waypoint")
    )
    error = refusal(lambda: load(path, {"dt": -1}))
    assert [line.split(": ")[0] for line in str(error).splitlines() if line[0] != " "] == [
        "--set dt=-1",
        "run.yaml:2:9",
        "run.yaml:3:11",
        "run.yaml:5:10",
        "run.yaml:9:8",
        "run.yaml:12:11",
    ]
    assert len(error.mistakes) == 6


def test_a_file_full_of_mistakes_gets_a_short_message(path):
    path.write_text(CONFIG + "".join(f"key{i}: 1\n" for i in range(3000)))
    lines = str(refusal(lambda: load(path))).splitlines()
    assert len(lines) == 3 * MOST_MISTAKES + 1
    assert lines[-1] == "… and more mistakes; these are the first"


def test_paths_are_relative_to_the_file(path, monkeypatch):
    folder = path.absolute().parent
    loaded = load(path)
    assert loaded.root == folder
    monkeypatch.chdir(folder.parent)
    assert load(folder / path) == loaded
    elsewhere = refusal(lambda: load(f"{folder.name}/run.yaml", {"scene": "amr.xml"}))
    assert "--set scene=amr.xml: there is no scene file 'amr.xml'" in str(elsewhere)
    message = str(refusal(lambda: load(f"{folder.name}/run.yaml", {"limits.velocity.x": 1})))
    assert message.startswith("--set limits.velocity.x=1: no joint named 'x'")


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        ("broken.xml", "does not compile"),
        ("loop.xml", "loop.xml"),
        ("x" * 5000, "xxx"),
        ("menagerie:no_such_robot", "no_such_robot"),
        ("''", "scene"),
    ],
)
def test_a_scene_that_cannot_be_loaded_is_one_mistake_among_others(path, scene, why):
    Path("broken.xml").write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    Path("loop.xml").symlink_to("loop.xml")
    path.write_text(CONFIG.replace("arm.xml", scene).replace("B: [1, 2]", "B: -1"))
    first, second = refusal(lambda: load(path)).mistakes
    assert first.place is not None
    assert second.place is not None
    assert (first.place.line, first.place.column) == (1, 8)
    assert why in first.message
    assert second.place.line == 9


def test_later_mistakes_find_their_places(path):
    loaded = load(path)
    error = config_error(
        [
            Mistake(("tasks", 1, "B"), "this task has 3 rows, and B has 2"),
            Mistake(("targets", "hand"), "the path cannot be built"),
            Mistake(("tasks", 0, "frame", "site"), "out of reach"),
            Mistake(("start", "shoulder"), "outside its range", key=True),
        ],
        loaded,
    )
    assert str(error).splitlines() == [
        "run.yaml:2:9: outside its range",
        "    start: {shoulder: 0.1}",
        "            ^",
        "run.yaml:6:26: out of reach",
        "        with: {frame: {site: hand}}",
        "                             ^",
        "run.yaml:9:8: this task has 3 rows, and B has 2",
        "        B: [1, 2]",
        "           ^",
        "run.yaml:11:3: the path cannot be built",
        "      hand:",
        "      ^",
    ]


def test_mistakes_without_a_file_say_which_value():
    error = config_error(
        [
            Mistake(("tasks", 2, "B"), "this task has 6 rows, and B has 5"),
            Mistake(("tasks", 1, "name"), "twice", other=("tasks", 0, "name")),
            Mistake((), "nothing fits"),
        ]
    )
    assert str(error).splitlines() == [
        "tasks[2].B: this task has 6 rows, and B has 5",
        "tasks[1].name: twice; the other is at tasks[0].name",
        "nothing fits",
    ]


def test_tabs_and_control_characters_do_not_move_the_caret(path):
    path.write_text("scene: arm.xml\ntasks: []\ndofs: [\t'\U0001f600', \tshuolder]\n")
    last = str(refusal(lambda: load(path))).splitlines()[-2:]
    assert last[0].index("shuolder") == last[1].index("^")


def test_show_says_where_each_value_comes_from(path):
    lines = {}
    for line in show(path, {"solver.backend": "osqp"}).splitlines():
        text, _, origin = line.partition("  # ")
        lines[text.strip()] = origin
    assert lines["scene: arm.xml"] == "run.yaml:1"
    assert lines["dt: 0.002"] == "default"
    assert lines["backend: osqp"] == "--set solver.backend=osqp"
    assert lines["lambda: 1e-06"] == "run.yaml:3"
    assert lines["- name: hand"] == "stacks/reach.yaml:6"
    assert lines["site: hand"] == "run.yaml:6"
    assert lines["gain: 20.0"] == "stacks/reach.yaml:4"
    assert lines["B: [1.0, 2.0]"] == "run.yaml:9"
    assert lines["default: 2.0"] == "stacks/reach.yaml:11"
    assert lines["- position: [1.0, 0.5, 0.0]"] == "run.yaml:15"
    shown = show(path, {"tasks.rest.B[1]": 5})
    assert "B: [1.0, 5.0]" in shown
    assert "# run.yaml:9, --set tasks.rest.B[1]=5\n" in shown


def test_what_is_shown_loads_to_the_same_configuration(path):
    loaded = load(
        path, {"tasks.rest.B": 1e-300, "targets.hand.through[0].quaternion": [1, 2, 3, 4]}
    )
    text = show(path, {"tasks.rest.B": 1e-300, "targets.hand.through[0].quaternion": [1, 2, 3, 4]})
    Path("shown.yaml").write_text(text)
    assert load("shown.yaml") == loaded


@pytest.mark.parametrize(
    "name", ["null", "a: b", "#1", "tr'ue", '"', "- x", "é\\", "x:", "1e5", ""]
)
def test_names_that_look_like_yaml_are_shown_in_quotes(path, name):
    key = name.replace("\\", "\\\\").replace('"', '\\"')
    quoted = name.replace("&", "&amp;").replace('"', "&quot;")
    scene = (GOLDEN / "arm.xml").read_text().replace('"shoulder"', f'"{quoted}"')
    Path("odd.xml").write_text(scene)
    path.write_text(CONFIG.replace("arm.xml", "odd.xml").replace("shoulder", f'"{key}"'))
    if not name:  # an unnamed joint has no name to be called by
        assert "no joint named ''" in str(refusal(lambda: load(path)))
        return
    loaded = load(path)
    assert loaded.start == {name: 0.1}
    Path("shown.yaml").write_text(show(path), encoding="utf-8")
    assert load("shown.yaml") == loaded


def test_a_configuration_is_what_it_says_not_where(path):
    loaded: Any = load(path)
    built = rmrc.Config(**loaded.resolved()).rooted(loaded.root)
    assert built == loaded
    assert built.place(("scene",)) is None
    again = pickle.loads(pickle.dumps(copy.deepcopy(loaded)))
    assert again == loaded
    assert str(again.place(("scene",))) == "run.yaml:1"
    assert Document() != "document"


def test_models_built_in_python_are_explained_too():
    def wrong() -> None:
        rmrc.FrameTask(name="hand", frame=rmrc.Frame(site="hand"), gain=-1, axes="wrold")  # type: ignore[arg-type]

    assert str(refusal(wrong)).splitlines() == [
        "gain: this must be greater than 0, not -1",
        "axes: 'axes' cannot be 'wrold'; did you mean 'world'? There is: body, world",
    ]


def test_a_config_built_in_python_says_all_mistakes():
    hand = rmrc.FrameTask(name="hand", frame=rmrc.Frame(site="hand"))
    wrong: Any = {"tasks": [hand, {"type": "posture"}], "dt": 0, "limits": {"velocity": "of"}}
    assert str(refusal(lambda: rmrc.Config(scene="arm.xml", **wrong))).splitlines() == [
        "dt: this must be greater than 0, not 0",
        "tasks[1].name: the key 'name' is missing: name of the task; targets, results and messages "
        "refer to it",
        "limits.velocity: a mapping with default or names of joints or 'off' is wanted here, "
        "not the text 'of'; did you mean 'off'?",
    ]
    twice = refusal(lambda: rmrc.Config(scene="arm.xml", tasks=(hand, hand)))
    assert str(twice) == (
        "tasks[1].name: two tasks are named 'hand', and names must differ; "
        "the other is at tasks[0].name"
    )
