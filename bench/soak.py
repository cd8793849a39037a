"""Random steps in all scenes, each held to what a step promises; prints what came of them.

Targets near, far and out of reach, pushes, limits that change on the way, obstacles that move, bad
and missing inputs: every step must be finite, inside its limits, and certified or reported. What
breaks a promise is printed with the command that does it again. `--json FILE` writes the figures
under `soak` into a file, beside what is there.
"""

import json
import os
import signal
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.progress import Progress

from timing import REPOSITORY, parser, write

sys.path.insert(0, str(REPOSITORY / "tests"))

from soaking.episode import Episode, Figures, Violation
from soaking.scenes import Scene, present

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


def _give_up(*_: object) -> None:
    raise TimeoutError(f"no end after {HUNG} s")


class Soak:
    """Goes round the scenes, and keeps count."""

    def __init__(self, scenes: list[Scene], steps: int, seed: int):
        self._scenes, self._first, self._seed = scenes, seed, seed
        whole = sum(scene.share for scene in scenes)
        self._wanted = {scene.name: round(steps * scene.share / whole) for scene in scenes}
        self._done: Counter[str] = Counter()
        self._figures = Figures()
        self._broken = 0
        self._memory: list[float] = []

    def run(self, progress: Progress) -> dict[str, Any]:
        """Return the figures of all steps, or of those so far after an interrupt (Ctrl-C)."""
        task = progress.add_task("soak", total=sum(self._wanted.values()))
        begin = time.perf_counter()
        signal.signal(signal.SIGALRM, _give_up)
        with TemporaryDirectory() as folder, suppress(KeyboardInterrupt):
            for turn in range(1, ROUNDS + 1):
                for scene in self._scenes:
                    while self._done[scene.name] * ROUNDS < self._wanted[scene.name] * turn:
                        self._episode(scene, Path(folder), progress)
                        progress.update(task, completed=self._done.total())
                self._memory.append(resident())
        signal.alarm(0)
        return self._summary(time.perf_counter() - begin)

    def _episode(self, scene: Scene, folder: Path, progress: Progress) -> None:
        """Walk from one seed, as far as no promise is broken; a broken one counts as a step."""
        count = min(EPISODE, self._wanted[scene.name] - self._done[scene.name])
        try:
            signal.alarm(HUNG)
            for _ in Episode(scene, self._seed, folder).run(count, self._figures):
                signal.alarm(HUNG)
                self._done[scene.name] += 1
        except Violation as broken:
            progress.console.print(f"{scene.name}: {broken}", highlight=False, soft_wrap=True)
            self._broken += 1
            self._done[scene.name] += 1
        self._seed += 1

    def _summary(self, seconds: float) -> dict[str, Any]:
        figures, memory = self._figures, self._memory
        return {
            "steps": figures.steps,
            "scenes": dict(self._done),
            "configurations": self._seed - self._first,
            "statuses": dict(figures.statuses.most_common()),
            "braking_steps": figures.braking,
            "broken_promises": self._broken,
            "worst": {kind: float(f"{worst:.3g}") for kind, worst in figures.worst.items()},
            "largest_kkt": float(f"{figures.kkt:.3g}"),
            "memory_growth_mb": round(memory[-1] - memory[0], 1) if memory else None,
            "slowest_step_ms": round(1e3 * figures.slowest[0], 1),
            "slowest_step": figures.slowest[1],
            "steps_per_second": round(figures.steps / seconds),
        }


def main() -> None:
    """Run the soak, print its figures, and exit with 1 if a promise was broken."""
    command = parser(__doc__)
    command.add_argument("--steps", type=int, default=1_000_000)
    command.add_argument("--scene", help="one configuration of this scene alone")
    command.add_argument("--seed", type=int, default=0)
    arguments = command.parse_args()
    if arguments.scene:
        scene = next(scene for scene in present() if scene.name == arguments.scene)
        with TemporaryDirectory() as folder:
            for _ in Episode(scene, arguments.seed, Path(folder)).run(arguments.steps, Figures()):
                pass
        return
    with Progress(disable=not sys.stdout.isatty()) as progress:
        figures = Soak(present(), arguments.steps, arguments.seed).run(progress)
    print(json.dumps(figures, indent=2))
    write(arguments.json, "soak", figures)
    sys.exit(1 if figures["broken_promises"] else 0)


if __name__ == "__main__":
    main()
