"""The instructions of a step, counted, and held to the committed baseline."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from models import REPOSITORY

BENCH = REPOSITORY / "bench"


@pytest.fixture
def instructions(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCH)
    import instructions  # pyright: ignore[reportMissingImports]

    return instructions


def test_what_a_called_function_took_is_not_counted_twice(
    instructions: ModuleType, tmp_path: Path
) -> None:
    counts = tmp_path / "counts"
    counts.write_text(
        "ob=(1) /here/_native.so\nfn=(1) step\n0 600\ncob=(2) /here/libmujoco.so\ncfn=(2) k\n"
        "calls=1 0\n0 400\n0 200\n\nob=(2)\nfn=(2)\n0 400\n\nob=(3) /here/libpython.so\n0 7000\n"
    )
    found = instructions.counts(counts)
    steps = instructions.STEPS
    assert found == {
        "instructions": 1200 / steps, "rmrc": 800 / steps, "mujoco": 400 / steps, "libm": 0.0,
    }  # fmt: skip


@pytest.mark.parametrize(("now", "fails"), [(104.9, False), (105.1, True), (50.0, False)])
def test_five_percent_more_are_too_many(instructions: ModuleType, now: float, fails: bool) -> None:
    def of(count: float) -> dict[str, dict[str, dict[str, float]]]:
        return {"cases": {"arm": {"instructions": count}}}

    assert bool(instructions.grown(of(now), of(100.0))) is fails


@pytest.mark.slow
def test_a_step_takes_no_more_instructions_than_the_baseline() -> None:
    done = subprocess.run(
        [sys.executable, BENCH / "instructions.py", "--check"],
        capture_output=True, text=True, check=False, timeout=1200,
    )  # fmt: skip
    if done.stdout.startswith("skipped: "):
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stderr
