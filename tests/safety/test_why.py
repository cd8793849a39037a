"""`rmrc why`: which step of a run, what binds, and what it cannot tell."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY
from rmrc import Status, cli

# `rmrc why`.


def why(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `rmrc why` here and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["rmrc", "why", *map(str, arguments)])
    with pytest.raises(SystemExit) as done:
        cli.main()
    code = done.value.code
    return 0 if code is None else int(code)


@pytest.fixture(scope="module")
def stuck_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose target is out of reach."""
    config = replace_target(0.6)
    folder = tmp_path_factory.mktemp("runs") / "stuck"
    rmrc.solve(config).save(folder)
    return folder


def replace_target(duration: float, **overrides: Any) -> rmrc.Config:
    path = {"path": "pose", "position": [2.0, 0.0, 0.0]}
    changes = {"targets": {"hand": path}, "duration": duration, "dt": 0.01, **overrides}
    return rmrc.load(REPOSITORY / "configs" / "planar_line.yaml", overrides=changes)


def test_why_says_which_step_and_what_binds(
    stuck_run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = rmrc.Run.load(stuck_run)
    assert why(monkeypatch, stuck_run) == 0
    shown = capsys.readouterr()
    worst = int(run.status.argmax())
    assert shown.out.startswith(f"step {worst} at {run.time[worst]:.4g} s\n")
    assert f"{Status(int(run.status[worst])).name}: " in shown.out.splitlines()[1]
    assert "what the tasks asked for and got:" in shown.out
    assert "hand: " in shown.out
    assert not shown.err
    limited = int(np.flatnonzero(run.active.any(axis=1))[0])
    assert why(monkeypatch, stuck_run, "--step", limited) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"step {limited} at ")
    assert "what binds:" in out
    assert "what would help most: relaxing the " in out


def test_why_gives_every_step_its_recorded_status(stuck_run: Path) -> None:
    from rmrc.runs.why import why as explain_step

    run = rmrc.Run.load(stuck_run)
    assert len(set(run.status.tolist())) > 1
    for k in range(0, len(run.time), 7):
        number, account = explain_step(run, k)
        assert number == k
        assert account.status == run.status[k]
        assert account.flags[0] == account.status
        [hand] = [task for task in account.tasks if task.name == "hand"]
        np.testing.assert_allclose(hand.error, run.error["hand"][k], rtol=0.0, atol=1e-9)
        expected = {name for name, at in zip(range(3), run.active[k], strict=True) if at}
        assert len(expected) <= len(account.bindings)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "nowhere"),
        ((".",), ""),
        (("RUN", "--step", "61"), "the run has the steps 0 to 60, and no step 61"),
        (("RUN", "--step", "-1"), "and no step -1"),
        (("RUN", "--step", "last"), "--step"),
        (("RUN", "--stp", "1"), "--stp"),
        ((), "RUN"),
    ],
    ids=["no folder", "no run", "too far", "negative", "no number", "no option", "no argument"],
)
def test_wrong_questions_are_one_clear_message_and_exit_2(
    stuck_run: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [str(stuck_run) if word == "RUN" else word for word in arguments]
    assert why(monkeypatch, *given) == 2
    shown = capsys.readouterr()
    assert message in shown.err
    assert "Traceback" not in shown.err
    assert not shown.out


def test_why_says_what_it_cannot_explain(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rmrc.solve(replace_target(0.05, method="dls")).save(tmp_path / "closed")
    assert why(monkeypatch, tmp_path / "closed") == 2
    assert "method dls" in capsys.readouterr().err


def test_a_run_whose_scene_is_gone_is_a_clear_message(
    stuck_run: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    folder = tmp_path / "moved"
    run = rmrc.Run.load(stuck_run)
    manifest = json.loads(json.dumps(run.manifest))
    manifest["config"]["scene"] = "gone.xml"
    replace(run, manifest=manifest).save(folder)
    assert why(monkeypatch, folder) == 2
    assert "gone.xml" in capsys.readouterr().err
