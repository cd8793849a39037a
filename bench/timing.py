"""What the benchmarks share: steps that take turns, their figures, and the file of results."""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
RUN = 50
"""Steps of one side before the next has its turn."""

StepOf = Callable[[int], np.ndarray]
"""Does step k, and returns the configuration that it leads to."""


def timed(step: StepOf, k: int) -> float:
    """Return how long step k takes, µs."""
    begin = time.perf_counter_ns()
    step(k)
    return (time.perf_counter_ns() - begin) / 1e3


def alternating(steps: Sequence[StepOf], warm_up: int, count: int) -> np.ndarray:
    """Return the times (count, sides) in µs of steps that take turns in short runs."""
    times = np.empty((warm_up + count, len(steps)))
    for begin in range(0, warm_up + count, RUN):
        for side, step in enumerate(steps):
            for k in range(begin, min(begin + RUN, warm_up + count)):
                times[k, side] = timed(step, k)
    return times[warm_up:]


def figures(names: Sequence[str], times: np.ndarray) -> dict[str, float]:
    """Return median and p99 in µs by side, and the ratio of the first two sides' medians."""
    medians, p99 = np.median(times, axis=0), np.percentile(times, 99, axis=0)
    found = {}
    for name, median, slow in zip(names, medians, p99, strict=True):
        found[f"{name}_median_us"] = round(float(median), 2)
        found[f"{name}_p99_us"] = round(float(slow), 2)
    return found | {"ratio": round(float(medians[0] / medians[1]), 3)}


def machine() -> str:
    """Return the processor, the number of cores and the interpreter."""
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        processor = names[0].split(":")[1].strip() if names else processor
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}"


def parser(description: str | None) -> argparse.ArgumentParser:
    """Return what reads a benchmark's command line; the Menagerie is where it stands beside us."""
    found = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    found.add_argument("--json", type=Path, help="write the figures into this file too")
    beside = REPOSITORY.parent / "shared" / "menagerie"
    if beside.is_dir():
        os.environ.setdefault("MENAGERIE_ROOT", str(beside))
    return found


def write(path: Path | None, key: str, found: dict[str, Any]) -> None:
    """Write figures under a key of a file, beside what is there."""
    if path is None:
        return
    kept = json.loads(path.read_text()) if path.exists() else {}
    kept[key] = {"machine": machine(), **found}
    path.write_text(json.dumps(kept, indent=2) + "\n")
