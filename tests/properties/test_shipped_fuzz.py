"""Whatever becomes of a shipped file, checking it gives a configuration or one clear message."""

import os
import random
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from models import REPOSITORY
from properties.mutate import Mutator
from rmrc.config.load import load
from rmrc.errors import ConfigError, ModelError
from rmrc.runs.check import check

# Seconds of the processor that checking one file may take, and bytes beyond those before it.
SOON = 2.0
MOST_MEMORY = 500e6
# Characters of a message: twenty mistakes, each with its line, and names of some length.
LONGEST_MESSAGE = 60_000
# Mutations of a file: so many in every run of the tests, and in `make test-slow`.
SOME, MANY = 120, 20_000

CONFIGS = sorted((REPOSITORY / "configs").glob("*.yaml"))
STACKS = sorted((REPOSITORY / "tasks").glob("*.yaml"))


def user_of(stack: Path) -> Path:
    """Return a configuration that uses a stack, and needs no robot of the Menagerie."""
    texts = {path: path.read_text() for path in CONFIGS}
    return next(p for p, text in texts.items() if stack.name in text and "menagerie:" not in text)


@pytest.fixture(params=[*CONFIGS, *STACKS], ids=lambda path: f"{path.parent.name}/{path.stem}")
def shipped(request: pytest.FixtureRequest) -> Path:
    if "menagerie:" in request.param.read_text():
        request.getfixturevalue("menagerie")
    return request.param


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the shipped files; a robot that is not on the disk is not downloaded."""
    for name in ("configs", "tasks", "scenes"):
        shutil.copytree(REPOSITORY / name, tmp_path / name)
    if "MENAGERIE_ROOT" not in os.environ:
        monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    return tmp_path


def memory(key: str) -> float:
    """Return VmRSS, what the process has in memory, or VmHWM, the most that it had, in bytes."""
    status = Path("/proc/self/status").read_text()
    found = re.search(rf"{key}:\s*(\d+) kB", status)
    assert found is not None
    return float(found[1]) * 1e3


@contextmanager
def little_memory() -> Iterator[None]:
    """Hold the peak inside to `MOST_MEMORY` above what there was before."""
    if not Path("/proc/self/clear_refs").exists():
        yield  # only Linux tells
        return
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    yield
    assert memory("VmHWM") - before < MOST_MEMORY


def refusal(config: Path) -> str | None:
    """Check a configuration in time; return the message if it is refused."""
    began = time.process_time()
    message = None
    try:
        check(load(config))
    except (ConfigError, ModelError) as error:
        message = str(error)
    assert time.process_time() - began < SOON
    if message is not None:
        assert message.strip()
        assert len(message) < LONGEST_MESSAGE
        assert all(line.isprintable() for line in message.split("\n"))
        assert message.encode()  # half of a surrogate pair cannot be written
    return message


# A number near the largest float is a number, though what is computed from it may overflow.
@pytest.mark.filterwarnings("ignore:.* encountered in:RuntimeWarning")
@pytest.mark.parametrize("count", [SOME, pytest.param(MANY, marks=pytest.mark.slow)])
def test_a_mutated_file_is_checked_or_refused(shipped: Path, folder: Path, count: int) -> None:
    file = folder / shipped.parent.name / shipped.name
    stack = shipped.parent.name == "tasks"
    config = folder / "configs" / user_of(shipped).name if stack else file
    assert refusal(config) is None
    mutator, chance = Mutator(file.read_bytes()), random.Random(shipped.stem)
    refused = 0
    with little_memory():
        for _ in range(count):
            file.write_bytes(mutator(chance))
            refused += refusal(config) is not None
    assert 0 < refused < count
