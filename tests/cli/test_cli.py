"""The command line: exit codes, one clear message, and never a traceback."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import rmrc

from models import REPOSITORY
from rmrc.__main__ import INTERRUPTED

LINE = REPOSITORY / "configs" / "planar_line.yaml"


def test_solve_prints_a_summary_and_counts_run_folders_up(tmp_path: Path) -> None:
    for number in ("0001", "0002"):
        done = rmrc("solve", LINE, "--set", "duration=2.5", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "converged" in done.stdout
        assert f"run folder: runs/planar_line-{number} · look at runs/" in done.stdout
        assert (tmp_path / "runs" / f"planar_line-{number}" / "report.html").is_file()
    assert done.stderr == ""


def test_a_run_that_does_not_converge_exits_1_and_is_saved(tmp_path: Path) -> None:
    done = rmrc("solve", LINE, "--set", "duration=0.1", "--json", "--out", "half", cwd=tmp_path)
    assert done.returncode == 1
    assert json.loads(done.stdout)["converged"] is False
    assert (tmp_path / "half" / "run.json").is_file()


def test_report_and_show_and_schema_and_check(tmp_path: Path) -> None:
    rmrc("solve", LINE, "--set", "duration=0.1", "--out", "run", cwd=tmp_path)
    (tmp_path / "run" / "report.html").unlink()
    assert rmrc("report", "run", cwd=tmp_path).returncode == 0
    assert (tmp_path / "run" / "report.html").is_file()
    shown = rmrc("show", LINE, cwd=tmp_path)
    assert shown.returncode == 0
    assert "default" in shown.stdout
    schema = rmrc("schema", cwd=tmp_path)
    assert json.loads(schema.stdout)["$schema"].startswith("https://json-schema.org/")
    checked = rmrc("check", LINE, REPOSITORY / "configs" / "panda_line.yaml", cwd=tmp_path)
    assert checked.returncode == 0
    assert checked.stdout.count(": ok") == 2
    assert "3 of 3 dofs move; tasks: hand (frame, level 0)" in checked.stdout
    assert "the damping is the default, λ = 0.01" in checked.stdout


def test_a_run_that_starts_outside_and_comes_back_exits_0(tmp_path: Path) -> None:
    scene = REPOSITORY / "scenes" / "planar_3r.xml"
    (tmp_path / "out.yaml").write_text(
        f"scene: {scene}\nstart: home\nduration: 0.5\n"
        "tasks: [{name: posture, type: posture, B: 0.0}]\n"
        "limits: {position: {joint1: [0.6, 2.0]}}\n"
    )
    done = rmrc("solve", "out.yaml", "--out", "run", cwd=tmp_path)
    assert "started outside by" in done.stdout, done.stdout + done.stderr
    assert "passed by" not in done.stdout
    assert done.returncode == 0
    assert "started outside by" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def broken(tmp_path: Path) -> dict[str, tuple[object, ...]]:
    """Return command lines that are wrong, each in its own way."""
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes(range(256)))
    listing = tmp_path / "list.yaml"
    listing.write_text("- 1\n- 2\n")
    huge = tmp_path / "huge.yaml"
    huge.write_text("a: " + "x" * 10_500_000)
    deep = tmp_path / "deep.yaml"
    deep.write_text("a: " + "[" * 2000 + "]" * 2000)
    unknown = tmp_path / "unknown.yaml"
    unknown.write_text(
        f"scene: {REPOSITORY / 'scenes' / 'panda.xml'}\n"
        "tasks:\n  - {name: hand, type: frame, frame: {site: hnad}}\n"
    )
    model = tmp_path / "model.xml"
    model.write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    scene = tmp_path / "scene.yaml"
    scene.write_text("scene: model.xml\ntasks: [{name: p, type: posture}]\n")
    return {
        "missing": ("solve", "nowhere.yaml"),
        "folder": ("solve", "."),
        "binary": ("solve", binary),
        "list": ("solve", listing),
        "huge": ("solve", huge),
        "deep": ("solve", deep),
        "unknown": ("solve", unknown),
        "scene": ("solve", scene),
        "option": ("solve", LINE, "--set", "solver.backnd=osqp"),
        "option form": ("solve", LINE, "--set", "nonsense"),
        "backend": ("solve", LINE, "--set", "solver.backend=gurubi"),
        "command": ("slove", LINE),
        "no argument": ("solve",),
        "no run": ("report", "."),
        "no run to render": ("render", ".", "-o", "a.png"),
        "bad picture": ("render", ".", "-o", "a.bmp"),
        "check": ("check", unknown, LINE),
    }


CASES = [
    "missing",
    "folder",
    "binary",
    "list",
    "huge",
    "deep",
    "unknown",
    "scene",
    "option",
    "option form",
    "backend",
    "command",
    "no argument",
    "no run",
    "no run to render",
    "bad picture",
    "check",
]


@pytest.mark.parametrize("case", CASES)
def test_wrong_input_is_one_clear_message_exit_2_and_no_run_folder(
    case: str, tmp_path: Path
) -> None:
    command = broken(tmp_path)[case]
    done = rmrc(*command, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert done.stderr.strip()
    assert not (tmp_path / "runs").exists()


def test_an_existing_folder_is_never_overwritten(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").write_text("all of it")
    done = rmrc("solve", LINE, "--set", "duration=0.1", "--out", "precious", cwd=tmp_path)
    assert done.returncode == 2
    assert "precious" in done.stderr
    assert (precious / "thesis.tex").read_text() == "all of it"


def interrupted(folder: Path, after: float) -> tuple[int, str, str]:
    """Run an hour, interrupt it after so many seconds; return its exit code and what it printed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "rmrc", "solve", str(LINE), "--set", "duration=3600"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # A shell that starts a job in the background has it ignore interrupts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    return process.returncode, stdout, stderr


@pytest.mark.parametrize(
    "module",
    ["rmrc.cli", "typer", "rich.table", "numpy", "mujoco", "pydantic", "rmrc.runs.solve"],
)
def test_ctrl_c_during_the_imports_is_one_line(module: str, tmp_path: Path) -> None:
    program = f"""
import os, signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting())
from rmrc.__main__ import main
sys.argv = ["rmrc", "solve", {str(LINE)!r}]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == INTERRUPTED, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_way_in_imports_nothing_that_takes_time() -> None:
    program = (
        "import sys; before = set(sys.modules); import rmrc.__main__;"
        "print(*sorted(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    roots = {name.partition(".")[0] for name in done.stdout.split()}
    assert roots - sys.stdlib_module_names == {"rmrc"}
    assert "importlib.metadata" not in done.stdout


def test_ctrl_c_saves_what_was_done(tmp_path: Path) -> None:
    for after in (4.0, 10.0, 25.0):  # a busy machine takes its time to import
        code, stdout, stderr = interrupted(tmp_path, after)
        if code != INTERRUPTED:
            break
    assert code == 1, stderr
    assert "Traceback" not in stderr
    assert "interrupted" in stdout
    manifest = json.loads((tmp_path / "runs" / "planar_line-0001" / "run.json").read_text())
    assert manifest["interrupted"]
    assert 0 < manifest["summary"]["steps"] < 3600 / 0.002
