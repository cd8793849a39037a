"""What the benchmarks share: sides that take turns, their figures, and the file of results."""

import argparse
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
RESULTS = REPOSITORY / "bench" / "results.json"
RUN, COLD = 50, 10
"""Steps of one side before the next has its turn, and the steps before them that do not count: they
bring back what the other sides have driven out of the caches."""

StepsOf = Callable[[int, int], Sequence[float]]
"""Takes the steps from the one number to before the other, and returns their times in µs."""


def alternating(sides: Mapping[str, StepsOf], warm_up: int, count: int) -> dict[str, np.ndarray]:
    """Return the times in µs of sides that take turns: (turns, COLD + RUN), warm-up excluded."""
    turn = COLD + RUN
    times: dict[str, list[Sequence[float]]] = {name: [] for name in sides}
    for begin in range(0, turns(warm_up, count) * turn, turn):
        for name, steps in sides.items():
            times[name].append(steps(begin, begin + turn))
    return {name: np.array(taken[-(count // RUN) :]) for name, taken in times.items()}


def turns(warm_up: int, count: int) -> int:
    """Return how often it is each side's turn."""
    return -(-warm_up // (COLD + RUN)) + count // RUN


def figures(times: np.ndarray) -> dict[str, float]:
    """Return median, p99 and p99.9 of times in µs, and the median of the first steps of turns."""
    counted = times[:, COLD:]
    found = {f"p{rank:g}_us": np.percentile(counted, rank) for rank in (99.0, 99.9)}
    found = {"median_us": np.median(counted), **found, "cold_us": np.median(times[:, 0])}
    return {name: round(float(time), 2) for name, time in found.items()}


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
    path.write_text(json.dumps(kept, indent=2, ensure_ascii=False) + "\n")
