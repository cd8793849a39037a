"""Whatever a file holds, loading it gives a configuration or one `ConfigError`, and soon."""

import json
import os
import random
import re
import time
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path

import pytest

from properties.mutate import edit_bytes
from rmrc.config.load import load, show
from rmrc.config.models import Config
from rmrc.errors import ConfigError
from rmrc.runs.check import check

# Seconds that a file may take; one of a few hundred bytes takes some hundredths.
SOON = 2.0
# Bytes that a process may have taken at its end, 100 MB of them for what it imports.
MOST_MEMORY = 500e6
# Seconds after which a process that waits for something is given up, on a loaded machine.
HUNG = 60.0
# Characters of a line of a message, whatever it quotes.
WIDEST = 3000
MUTATIONS = 400

CONFIG = """\
# The hand moves while the elbow rests.
scene: arm.xml
start: {shoulder: 0.1, elbow: 0.2}
dt: 2e-3
damping: {lambda: 0.01}
metric: [1.0, 2.0]
dofs: [shoulder, elbow]
tasks:
  - use: stack.yaml
    with: {frame: {site: hand}, gain: 5}
    override: {hand: {B: {position: 2.0}}}
  - {name: rest, type: posture, level: 1, B: [[2.0, 1.0], [1.0, 2.0]], target: home}
  - &gaze
    name: gaze
    type: look_at
    frame: {body: lower}
    target: [1.0, 2, -.5]
limits:
  position: {margin: 0.01}
  velocity: &caps {default: 2.0, elbow: 1.0}
  acceleration: *caps
targets:
  hand:
    path: line
    to: {position: [1.0, 1.0, 0.0], quaternion: [1, 0, 0, 0]}
    duration: 3.0
"""
STACK = """\
parameters:
  frame: null
  gain: 20.0
tasks:
  - {name: hand, type: frame, frame: $frame, gain: $gain, B: {position: 1.0, orientation: 0.5}}
limits:
  velocity: {default: 2.0}
"""
SCENE = (Path(__file__).parents[1] / "unit" / "text" / "golden" / "config" / "arm.xml").read_text()


def refuses(config: Path) -> bool:
    """Load a file in time, and what is shown of it again; tell whether it is refused."""
    began = time.process_time()
    loaded, refusal = None, None
    try:
        loaded = load(config)
    except ConfigError as error:
        refusal = error
    assert time.process_time() - began < SOON
    if loaded is None:
        assert refusal is not None
        assert refusal.mistakes
        assert all(mistake.place is not None for mistake in refusal.mistakes)
        assert str(refusal).encode()  # it can be printed
        return True
    text = show(config)
    config.write_text(text, encoding="utf-8")
    assert load(config).resolved() == loaded.resolved()
    return False


def test_a_mutated_file_loads_or_is_refused_with_places(tmp_path):
    chance = random.Random(0)
    (tmp_path / "arm.xml").write_text(SCENE)
    config, stack = tmp_path / "fuzz.yaml", tmp_path / "stack.yaml"
    refused = []
    for _ in range(MUTATIONS):
        in_stack = chance.random() < 0.25
        file, text = (stack, STACK) if in_stack else (config, CONFIG)
        config.write_text(CONFIG)
        stack.write_text(STACK)
        file.write_bytes(edit_bytes(text.encode(), chance))
        refused.append(refuses(config))
    assert any(refused)
    assert not all(refused)


def test_what_is_mutated_loads_as_it_is(tmp_path):
    (tmp_path / "arm.xml").write_text(SCENE)
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "fuzz.yaml").write_text(CONFIG)
    assert isinstance(load(tmp_path / "fuzz.yaml"), Config)


def alone(config: str, out: Path) -> None:
    """Check a configuration, and write down the refusal, the time and the most memory it took."""
    began, refusal = time.process_time(), ""
    try:
        check(load(config))
    except ConfigError as error:
        refusal = str(error)
    seconds = time.process_time() - began
    status = Path("/proc/self/status")
    peak = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    out.write_text(json.dumps([refusal, seconds, int(peak[1]) * 1e3 if peak else 0.0]))


def scene(line: str) -> str:
    return CONFIG.replace("arm.xml", line)


def stack(line: str) -> str:
    return CONFIG.replace("stack.yaml", line)


def path(line: str) -> str:
    return f"{CONFIG.partition('targets:')[0]}targets: {{hand: {{path: file, file: {line}}}}}"


BOMB = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 9)}]\n" for i in range(40))
CHAIN = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 5000))
OUTSIDE = "../" * 30 + "etc/passwd"
NO_SCENE, TOO_MANY, TOO_LARGE = "there is no scene file", "at most 20000 values", "at most 500 kB"
# What the file holds, and what is said of it.
HOSTILE = {
    "alias bomb": (BOMB, TOO_MANY),
    "chain of aliases": (CHAIN, "at most 50 levels deep"),
    "alias of itself": ("a: &a [*a]", "the alias *a stands inside what it refers to"),
    "10 MB scalar": ("scene: " + "x" * 10_000_000, TOO_LARGE),
    "long scalar": ("scene: " + "x" * 400_000, "a text has at most 10000 characters"),
    "50,000 brackets": ("a: " + "[" * 50_000, "at most 50 levels deep"),
    "50,000 braces": ("a: " + "{a: " * 50_000, "at most 50 levels deep"),
    "50,000 dashes": ("- " * 50_000, "at most 50 levels deep"),
    "many tasks of no type": ("scene: arm.xml\ntasks: [" + "{}, " * 19_000 + "]", "is missing"),
    "many stacks that are not there": (
        "tasks:\n" + "".join(f"  - use: {i}.yaml\n" for i in range(6000)),
        "there is no such file",
    ),
    "many targets of no task": (
        CONFIG + "".join(f"  j{i}: {{path: hold}}\n" for i in range(4900)),
        "no task named 'j0'",
    ),
    "text that a stack makes long": (
        "tasks: [{use: long.yaml, with: {x: " + "y" * 500 + "}}]",
        "a text has at most 10000 characters",
    ),
    "stack that uses itself": (stack("fuzz.yaml"), "a stack has no scene"),
    "stack that uses a stack": ("tasks: [use: self.yaml]", "a stack cannot use a stack"),
    "stack outside": (stack(OUTSIDE), "etc/passwd:1:"),
    "stack that never ends": (stack("/dev/zero"), "this is not a regular file"),
    "stack in a pipe": (stack("pipe.yaml"), "this is not a regular file"),
    "stack in a folder": (stack("."), "this is a folder, not a file"),
    "stack of 100 MB": (stack("zeros.yaml"), TOO_LARGE),
    "scene outside": (scene(OUTSIDE), "does not compile"),
    "scene that never ends": (scene("/dev/zero"), NO_SCENE),
    "scene of the terminal": (scene("/dev/stdin"), NO_SCENE),
    "scene in a pipe": (scene("pipe.yaml"), NO_SCENE),
    "scene in a folder": (scene("/"), "is a folder; name a file in it"),
    "scene of 100 MB": (scene("zeros.yaml"), "is larger than 10 MB"),
    "scene far down": (scene("h/" * 4000), "scene"),
    "path that never ends": (path("/dev/zero.csv"), "there is no such file"),
    "path in a pipe": (path("pipe.csv"), "there is no such file"),
    "steps without end": (CONFIG.replace("2e-3", "1e-300"), "a run has at most"),
    "steps without number": (
        CONFIG.replace("2e-3", "1e-300\nduration: 1e90"),
        "a run has at most",
    ),
    "numbers whose squares overflow": (
        CONFIG.replace("lambda: 0.01", "lambda: 1e200").replace("gain: 5", "gain: 1e200"),
        "a number cannot be larger than 1e+100",
    ),
    "binary": ("\x7fELF\x02\x01\x01\0\0", "this is a binary file, not text"),
    "empty": ("", "the file is empty"),
}
FILES = {
    "zeros.yaml": TOO_LARGE,
    "pipe.yaml": "this is not a regular file",
    "/dev/zero": "this is not a regular file",
    "/dev/stdin": "this is not a regular file",
    ".": "this is a folder, not a file",
    OUTSIDE: "etc/passwd:1:",
}


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a pipe that nobody writes to, 100 MB of zeros, and a stack that uses itself."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(SCENE)
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "self.yaml").write_text("tasks: [{use: self.yaml}]\n")
    long = "parameters: {x: null}\ntasks: [{name: a, type: posture, target: '%s'}]\n"
    (tmp_path / "long.yaml").write_text(long % ("${x}" * 100))
    for name in ("pipe.yaml", "pipe.csv"):
        os.mkfifo(tmp_path / name)
    with (tmp_path / "zeros.yaml").open("wb") as file:
        file.truncate(100_000_000)
    return tmp_path


@pytest.mark.skipif("forkserver" not in get_all_start_methods(), reason="needs fork")
@pytest.mark.parametrize("case", [*HOSTILE, *FILES])
def test_a_hostile_file_is_refused_soon_and_in_little_memory(hostile: Path, case: str) -> None:
    text, why = HOSTILE.get(case, ("", FILES.get(case)))
    config = hostile / "fuzz.yaml"
    config.write_text(text, encoding="utf-8")
    processes = get_context("forkserver")
    processes.set_forkserver_preload(["rmrc.runs.check", "rmrc.config.load"])
    name = "fuzz.yaml" if case in HOSTILE else case
    process = processes.Process(target=alone, args=(name, hostile / "out.json"), daemon=True)
    process.start()
    process.join(HUNG)
    assert process.exitcode == 0
    refusal, seconds, memory = json.loads((hostile / "out.json").read_text())
    assert why in refusal
    assert all(line.isprintable() and len(line) < WIDEST for line in refusal.split("\n"))
    assert seconds < SOON
    assert memory < MOST_MEMORY
