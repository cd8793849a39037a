"""The fuzz of the extension under the sanitizers: `tests/fuzzing`, `python -m fuzzing` by hand."""

import subprocess
import sys

import pytest

import sanitized

LONG = 1800.0
"""s: half an hour, in `make test-slow`."""
SHORT = 20.0
"""s: with what the build takes, a minute."""
MOST_OVER = 120.0
"""s that one case, and the start, may take on a machine that is busy."""


@pytest.mark.parametrize(
    ("seconds", "seed"), [(SHORT, 0), pytest.param(LONG, 1_000_000, marks=pytest.mark.slow)]
)
def test_nothing_that_comes_in_does_harm(seconds: float, seed: int) -> None:
    module, environment = sanitized.extension(), sanitized.runtime()
    options = ["--seconds", str(seconds), "--seed", str(seed), "--module", str(module)]
    done = subprocess.run(
        [sys.executable, "-m", "fuzzing", *options],
        env=environment,
        capture_output=True,
        text=True,
        timeout=seconds + MOST_OVER,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr[-20_000:]}"
