"""Characters of a model's names that a terminal or a browser would obey are written out."""

import json
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

import rmrc
from rmrc.cli import console, main
from rmrc.errors import ModelError

SCENE = """
<mujoco>
  <worldbody>
    <body name="arm&#x1b;[31m">
      <joint name="bend&#x1b;[31m&#7;" range="-1 1" limited="true"/>
      <geom name="rod&#x9b;31m" type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>
      <body name="fore&#x202e;" pos="1 0 0">
        <joint name="fold&#10;" range="-1 1" limited="true"/>
        <geom name="tip&#x1b;]0;t&#7;" type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>
        <site name="hand&#x1b;[2J" pos="1 0 0"/>
      </body>
    </body>
    <body name="cup&#x1b;[31m" pos="1.8 0.2 0"><joint name="lid&#x1b;[5m"/><geom size="0.1"/></body>
  </worldbody>
  <actuator><position joint="bend&#x1b;[31m&#7;"/><position joint="fold&#10;"/></actuator>
  <keyframe><key name="home" qpos="1.5 -0.9999 0"/></keyframe>
</mujoco>
"""
CONFIG = """
scene: evil.xml
dt: 0.01
duration: 0.2
tasks:
  - {name: hand, type: frame, frame: {site: "hand\\e[2J"}}
  - {name: posture, type: posture, level: 1}
limits: {collision: {pairs: all, d_min: 0.01}, velocity: {default: 0.1}}
targets: {hand: {path: line, to: {position: [3.5, 0, 0]}, duration: 0.1}}
"""
OBEYED = ("\x1b[31m\x07", "cup\x1b", "hand\x1b", "arm\x1b", "lid\x1b", "\x9b", "\u202e", "\x07")


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("evil.xml").write_text(SCENE)
    Path("evil\x1b[31m.yaml").write_text(CONFIG)
    return "evil\x1b[31m.yaml"


def said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> str:
    """Return all that a command prints."""
    monkeypatch.setattr("sys.argv", ["rmrc", *arguments])
    with pytest.raises(SystemExit):
        main()
    return "".join(capsys.readouterr())


def test_what_commands_print(
    config: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments in (
        ("check", config),
        ("check", config, "--set", "tasks[0].frame.site=tip"),
        ("show", config),
        ("solve", config, "--out", "run"),
        ("solve", config, "--json"),
        ("why", "run"),
        ("compare", config, "--methods", "qp", "--sweep", "dt=0.01,0.02"),
        ("report", "run", "-o", "again\x07.html"),
        ("why", "none\x1b[31m"),
    ):
        text = said(monkeypatch, capsys, *arguments)
        unseen = {c for c in text if not c.isprintable()} - {"\n"}
        assert not unseen, (arguments, unseen)
    for page in (*Path().glob("*.html"), *Path().glob("comparisons/*/*"), *Path().glob("run/*.*")):
        if page.suffix != ".npz":
            text = page.read_text(encoding="utf-8")
            assert not [name for name in OBEYED if name in text]
    assert r"bend\x1b[31m\x07" in Path("run/report.html").read_text(encoding="utf-8")


def test_the_progress_bar(
    config: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "Console", partial(Console, force_terminal=True, no_color=True))
    text = said(monkeypatch, capsys, "solve", config)
    assert r"evil\x1b[31m" in text
    assert not [name for name in OBEYED if name in text]


def test_what_python_says(config: str) -> None:
    problem = rmrc.compile(rmrc.load(config))
    controller = rmrc.Controller(problem)
    with pytest.raises(ModelError) as mistake:
        controller.set_obstacle("x\x1b[31m", [0, 0, 0])
    assert str(mistake.value).isprintable()
    controller.set_target("hand", [3.5, 0, 0])
    step = controller.step(dt=0.1)
    for _ in range(200):
        step = controller.step(dt=0.1)
    assert step.status is rmrc.Status.STUCK
    assert step.reasons
    assert all(reason.isprintable() for reason in step.reasons)
    assert all(line.isprintable() for line in str(step.explain()).split("\n"))


def test_names_are_read_back_as_they_are(config: str) -> None:
    run = rmrc.solve(rmrc.load(config))
    run.save("run", report=False)
    names = [
        joint["name"] for joint in json.loads(Path("run/run.json").read_text())["model"]["joints"]
    ]
    assert names == ["bend\x1b[31m\x07", "fold\n"]
