"""A command killed at any moment leaves a whole folder or none, and nothing in the next's way."""

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from itertools import count
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

import rmrc
from models import REPOSITORY
from rmrc.cli import main
from rmrc.record.run import MANIFEST, REPORT, TRAJECTORY
from rmrc.runs.compare import NUMBERS, PAGE

LINE = REPOSITORY / "configs" / "planar_line.yaml"
SHORT = (str(LINE), "--set", "duration=0.1")
SOLVE = ("solve", *SHORT)
COMPARE = ("compare", *SHORT, "--methods", "qp,dls", "--backends", "daqp")
# Kills of a command at a random moment; half of them while its folder is written.
KILLS = 16
WHOLE = 3
"""Runs that nothing kills, of which the shortest tells how long one takes."""
# Kills of a program from its very start, whose imports take most of the time.
KILLS_OF_PROGRAM = 4
# More operations on files than a command has.
MOST_OPERATIONS = 60

pytestmark = pytest.mark.skipif(
    "forkserver" not in get_all_start_methods(), reason="needs fork and SIGKILL"
)


@pytest.fixture(scope="module")
def processes() -> ForkServerContext:
    """Processes that have imported everything already, so that a kill falls into the work."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["rmrc.cli", "rmrc.runs.compare", "rmrc.record.run"])
    return context


def command(folder: Path, arguments: tuple[str, ...], kill_at: int | None = None) -> None:
    """Run the command line in a folder; die before the `kill_at`-th operation on files there."""
    os.chdir(folder)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    done = count()

    def watch(event: str, values: tuple[object, ...]) -> None:
        if event == "open" or event.startswith(("os.", "shutil.")):
            here = any(str(value).startswith(str(folder)) for value in values)
            if here and next(done) == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    sys.argv = ["rmrc", *arguments]
    main()


def is_whole(folder: Path, kind: str) -> bool:
    """Return whether there is a folder; if there is, it must be what the command leaves."""
    if not folder.exists():
        return False
    files = {path.name for path in folder.iterdir()}
    if kind == "compare":
        assert files == {NUMBERS, PAGE}
        assert len(json.loads((folder / NUMBERS).read_text())["summary"]["runs"]) == 2
        page = folder / PAGE
    else:
        assert files == {MANIFEST, TRAJECTORY, REPORT}
        assert len(rmrc.Run.load(folder).time) == 51
        page = folder / REPORT
    assert page.read_text().endswith("</html>\n")
    return True


def start(processes: ForkServerContext, folder: Path, *arguments: str, **at: int) -> BaseProcess:
    process = processes.Process(target=command, args=(folder, arguments), kwargs=at)
    process.start()
    return process


def results(folder: Path, kind: str) -> list[str]:
    """Return the names of the folders that a command has left, each of them whole."""
    parent = folder / ("comparisons" if kind == "compare" else "runs")
    visible = [path for path in parent.iterdir() if path.name[0] != "."]
    assert all(is_whole(path, kind) for path in visible)
    return sorted(path.name for path in visible)


@pytest.mark.parametrize("arguments", [SOLVE, COMPARE], ids=["solve", "compare"])
def test_killed_before_any_operation_on_files(
    processes: ForkServerContext, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    found = []
    for operation in range(MOST_OPERATIONS):
        out = tmp_path / f"{arguments[0]}-{operation}"
        process = start(processes, tmp_path, *arguments, "--out", str(out), kill_at=operation)
        process.join()
        found.append(is_whole(out, arguments[0]))
        if process.exitcode != -signal.SIGKILL:
            break
    assert found[-1], "the last one was not killed"
    # The first is killed before it writes; one killed after the folder has its name is whole.
    assert found == sorted(found)
    assert found.count(False) > 5
    assert found.count(True) > 1


@pytest.mark.parametrize("arguments", [SOLVE, COMPARE], ids=["solve", "compare"])
def test_killed_at_a_random_moment(
    processes: ForkServerContext, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    chance, whole = random.Random(0), math.inf
    for _ in range(WHOLE):
        began = time.monotonic()
        start(processes, tmp_path, *arguments).join()
        whole = min(whole, time.monotonic() - began)
    names, killed = results(tmp_path, arguments[0]), 0
    assert len(names) == WHOLE
    for kill in range(KILLS):
        process = start(processes, tmp_path, *arguments)
        if kill % 2:
            before = hidden(tmp_path)
            while process.is_alive() and hidden(tmp_path) == before:
                time.sleep(1e-3)
            time.sleep(chance.uniform(0, 0.3 * whole))
        else:
            time.sleep(chance.uniform(0, 1.1 * whole))
        process.kill()
        process.join()
        killed += process.exitcode == -signal.SIGKILL
        assert set(results(tmp_path, arguments[0])) >= set(names)  # what was there stays
        names = results(tmp_path, arguments[0])
    assert killed > KILLS // 2
    start(processes, tmp_path, *arguments).join()
    numbers = [int(name.rpartition("-")[2]) for name in results(tmp_path, arguments[0])]
    assert numbers == list(range(1, len(names) + 2))


def hidden(folder: Path) -> set[str]:
    """Return the names that a folder has while it is written."""
    return {path.name for path in folder.glob("*/.*")}


def test_a_program_killed_from_its_start_leaves_nothing(tmp_path: Path) -> None:
    chance = random.Random(0)
    for kill in range(KILLS_OF_PROGRAM):
        out = tmp_path / f"run-{kill}"
        line = [sys.executable, "-m", "rmrc", *SOLVE, "--out", str(out)]
        with subprocess.Popen(
            line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as program:
            time.sleep(chance.uniform(0, 2.0))
            program.kill()
        is_whole(out, "solve")
