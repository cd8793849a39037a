"""Random steps in all scenes, each held to what a step promises; prints what came of them.

Targets near, far and out of reach, pushes, limits that change on the way, obstacles that move, bad
and missing inputs: every step must be finite, inside its limits, and certified or reported. What
breaks a promise is printed with the command that does it again. `--json FILE` writes the figures
under `soak` into a file, beside what is there.
"""

import argparse
import json
import os
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.progress import Progress

from step import machine

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY / "tests"))

from soaking.episode import Episode, Figures, Violation  # noqa: E402
from soaking.scenes import Scene, present  # noqa: E402

EPISODE = 1000
"""Steps of one configuration."""
ROUNDS = 4
"""Times that every scene has its turn; memory counts from the end of the first."""
HUNG = 120
"""Seconds after which a step is given up."""


def resident() -> float:
    """Return the memory of this process in MB, 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    return (
        int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
        if pages.exists()
        else 0.0
    )


def shares(scenes: list[Scene], steps: int) -> dict[str, int]:
    """Return the number of steps of each scene."""
    whole = sum(scene.share for scene in scenes)
    return {scene.name: round(steps * scene.share / whole) for scene in scenes}


def _give_up(*_: object) -> None:
    raise TimeoutError(f"no end after {HUNG} s")


def soak(steps: int, scenes: list[Scene], first: int, progress: Progress) -> dict[str, Any]:
    """Return the figures of some steps over scenes, with seeds from the first on."""
    figures, failures, done, begin = Figures(), [], Counter(), time.perf_counter()
    wanted, memory = shares(scenes, steps), [resident()]
    task = progress.add_task("soak", total=sum(wanted.values()))
    seed = first
    signal.signal(signal.SIGALRM, _give_up)
    with TemporaryDirectory() as folder:
        for turn in range(ROUNDS):
            for scene in scenes:
                while done[scene.name] * ROUNDS < wanted[scene.name] * (turn + 1):
                    count = min(EPISODE, wanted[scene.name] - done[scene.name])
                    try:
                        for _ in Episode(scene, seed, Path(folder)).run(count, figures):
                            signal.alarm(HUNG)
                            done[scene.name] += 1
                            progress.advance(task)
                    except Violation as broken:
                        failures.append(str(broken))
                        progress.console.print(f"{scene.name}: {broken}", highlight=False)
                        done[scene.name] += 1
                    seed += 1
            memory.append(resident())
    signal.alarm(0)
    seconds = time.perf_counter() - begin
    return {
        "steps": figures.steps,
        "scenes": dict(done),
        "configurations": seed - first,
        "statuses": dict(figures.statuses.most_common()),
        "braking_steps": figures.braking,
        "worst": {kind: float(f"{worst:.3g}") for kind, worst in figures.worst.items()},
        "largest_kkt": float(f"{figures.kkt:.3g}"),
        "broken_promises": len(failures),
        "memory_growth_mb": round(memory[-1] - memory[1], 1),
        "slowest_step_ms": round(1e3 * figures.slowest, 1),
        "steps_per_second": round(figures.steps / seconds),
    }


def main() -> None:
    """Run the soak, print its figures, and exit with 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--scene", help="one configuration of this scene alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    arguments = parser.parse_args()
    beside = REPOSITORY.parent / "shared" / "menagerie"
    if beside.is_dir():
        os.environ.setdefault("MENAGERIE_ROOT", str(beside))
    if arguments.scene:
        scene = next(scene for scene in present() if scene.name == arguments.scene)
        with TemporaryDirectory() as folder:
            for _ in Episode(scene, arguments.seed, Path(folder)).run(arguments.steps, Figures()):
                pass
        return
    with Progress(disable=not sys.stdout.isatty()) as progress:
        figures = soak(arguments.steps, present(), arguments.seed, progress)
    print(json.dumps(figures, indent=2))
    if arguments.json:
        kept = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
        kept["soak"] = {"machine": machine(), **figures}
        arguments.json.write_text(json.dumps(kept, indent=2) + "\n")
    sys.exit(1 if figures["broken_promises"] else 0)


if __name__ == "__main__":
    main()
