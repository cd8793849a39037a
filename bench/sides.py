"""The sides of a benchmark: processes of their own, on one core, of which one at a time works."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from timing import REPOSITORY, StepsOf, alternating, figures

PEERS = REPOSITORY / "bench" / "peers"

SIDES = {
    "rmrc": ("rmrc", "auto"),
    "python": ("rmrc", "python"),
    "mink": ("mink", ""),
    "pink": ("pink", ""),
    "placo": ("placo", ""),
}
"""Module of `peers/` and what it is asked for: an engine, or of the peers a solver."""


def environment(side: str) -> Path:
    """Return the Python that a side runs in."""
    module = SIDES[side][0]
    return Path(sys.executable if module == "rmrc" else PEERS / f".venvs/{module}/bin/python")


class Child:
    """A side of the benchmark at work in its process."""

    def __init__(self, side: str, work: Path):
        module, option = SIDES[side]
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115 (the process writes to it)
        self._process = subprocess.Popen(
            [environment(side), PEERS / "child.py", module, option, work],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
        )
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(self._process.pid, {max(os.sched_getaffinity(0))})
        self.about = self._answer()
        self.q = np.empty(0)

    def steps(self, begin: int, end: int) -> Sequence[float]:
        """Take the steps from begin to before end, and return their times in µs."""
        assert self._process.stdin
        print(begin, end, file=self._process.stdin, flush=True)
        answer = self._answer()
        self.q = np.array(answer["q"])
        return answer["times"]

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            self._log.seek(0)
            raise SystemExit(f"{self._log.read()[-2000:]}\na side of the benchmark has ended")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        self._log.close()


def compare(sides: Sequence[str], work: Path, warm_up: int, steps: int) -> dict[str, Any]:
    """Return what each side is, its times, and how far from the first one's its last q is."""
    with ExitStack() as ending:
        children: dict[str, Child] = {}
        for side in sides:
            children[side] = Child(side, work)
            ending.callback(children[side].close)
        takers: Mapping[str, StepsOf] = {side: child.steps for side, child in children.items()}
        times = alternating(takers, warm_up, steps)
        first = children[sides[0]].q
        return {
            side: child.about
            | figures(times[side])
            | {"apart": float(f"{np.abs(child.q - first).max():.1e}")}
            for side, child in children.items()
        }
