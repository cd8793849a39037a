"""`rmrc inspect` and `rmrc init`: a newcomer sees what a model has, and it moves."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rmrc
from descriptions import ARM, FINGERS
from models import config as made
from rmrc.cli import app
from rmrc.errors import RmrcError
from rmrc.runs.check import check
from rmrc.runs.describe import described
from rmrc.runs.init import examples, init_example, init_scene, shipped
from rmrc.runs.inspect import inspect

Urdf = Callable[..., Path]

TWO_HANDS = (
    """<mujoco><worldbody><body name="chest"><geom size=".1"/>{}{}</body></worldbody></mujoco>"""
)
SIDE = """<body name="{0}_arm" pos="0 {1} 0"><joint name="{0}_j" range="-1 1"/><geom size=".1"/>
<site name="{0}_tool" pos=".4 0 0"/></body>"""


def test_inspect_says_what_there_is(urdf: Urdf) -> None:
    found = inspect(str(urdf(ARM, FINGERS)))
    joints = {joint["name"]: joint for joint in found["joints"]}
    assert joints["j1"]["range"] == [-2.0, 2.0]
    assert (joints["j1"]["speed"], joints["j1"]["speed_from"]) == (0.5, "file")
    assert joints["f1"]["effort"] == 5.0
    assert found["coupled"][0]["relation"] == "f2 = 0 + 1 · f1"
    lines = "\n".join(described(found))
    assert "tool0" in lines
    assert "f2 mimics f1" in lines


def test_inspect_of_a_configuration_prints_json(repository: Path) -> None:
    config = repository / "configs" / "panda_line.yaml"
    result = CliRunner().invoke(app, ["inspect", str(config), "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["keyframes"] == ["home"]
    assert "joint7" in CliRunner().invoke(app, ["inspect", str(config)]).stdout


@pytest.mark.parametrize("parts", [(ARM,), (ARM, FINGERS)])
def test_init_finds_the_tool_and_runs_at_once(urdf: Urdf, tmp_path: Path, parts: tuple) -> None:
    folder = tmp_path / "mine"
    said = init_scene(folder, str(urdf(*parts)))
    assert "'tool0'" in said[0]
    text = (folder / "config.yaml").read_text()
    assert text.startswith("# yaml-language-server: $schema=rmrc.schema.json\n")
    assert (folder / "rmrc.schema.json").is_file()
    assert "scene: ../robot.urdf" in text
    run = rmrc.solve(rmrc.load(folder / "config.yaml"))
    assert run.summary["converged"]
    assert abs(run.q[-1] - run.q[0]).max() > 0.1
    with pytest.raises(RmrcError, match=r"config.yaml is there already"):
        init_scene(folder, str(urdf(*parts)))


def test_init_says_which_frames_are_as_likely(tmp_path: Path) -> None:
    path = tmp_path / "two.xml"
    path.write_text(TWO_HANDS.format(SIDE.format("left", 0.2), SIDE.format("right", -0.2)))
    said = init_scene(tmp_path / "one", str(path))
    assert (
        said[0]
        == "site 'left_tool' is the end effector; as likely: right_tool (--frame takes another)"
    )
    other = init_scene(tmp_path / "other", str(path), "right_tool")
    assert "'right_tool'" in other[0]
    with pytest.raises(RmrcError, match="no joint of the robot moves 'chest'"):
        init_scene(tmp_path / "none", str(path), "chest")
    with pytest.raises(RmrcError, match="did you mean 'left_tool'"):
        init_scene(tmp_path / "none", str(path), "left_tol")


def test_without_a_scene_init_brings_its_own(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["init", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    assert rmrc.solve(rmrc.load(tmp_path / "new" / "config.yaml")).summary["converged"]


@pytest.mark.parametrize("name", ["panda_line", "dual_arm_collision", "panda_obstacle"])
def test_an_example_brings_all_that_it_needs(tmp_path: Path, name: str) -> None:
    init_example(tmp_path / "mine", name)
    assert rmrc.compile(rmrc.load(tmp_path / "mine" / "configs" / f"{name}.yaml"))


def test_examples_are_listed_with_what_they_show() -> None:
    assert len(examples()) == len(list((shipped() / "configs").glob("*.yaml")))
    assert all(examples().values())
    assert "panda_line" in CliRunner().invoke(app, ["init", "--list"]).stdout
    with pytest.raises(RmrcError, match="did you mean 'panda_line'"):
        init_example(Path("nowhere"), "panda_lin")


def test_the_build_packs_the_examples(repository: Path) -> None:
    import tomllib

    settings = tomllib.loads((repository / "pyproject.toml").read_text())
    packed = settings["tool"]["scikit-build"]["wheel"]["packages"]
    assert {packed[f"rmrc/data/{part}"] for part in ("scenes", "tasks", "configs")} == {
        "scenes",
        "tasks",
        "configs",
    }


def test_check_warns_of_very_many_dofs() -> None:
    body = (
        '<body name="b{0}"><joint name="j{0}"/><geom size=".1" contype="0" conaffinity="0"/></body>'
    )
    bodies = "".join(map(body.format, range(600)))
    scene = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    config = made(scene=scene, tasks=[{"name": "rest", "type": "posture"}])
    assert any("600 dofs are very many" in line for line in check(config))
