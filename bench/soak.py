"""Random steps in scenes and random trees, each held to what a step promises; prints the figures.

Targets near, far and out of reach, pushes, limits that change on the way, obstacles that move, bad
and missing inputs: every step must be finite, inside its limits, and certified or reported. An
episode is a walk in one random configuration, and a seed says all of it, whatever the workers. What
breaks a promise is printed with the command that does it again; so is the episode in which a worker
dies. `--json FILE` writes the figures under `soak` into a file, beside what is there.
"""

import json
import multiprocessing as mp
import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.progress import Progress

from timing import REPOSITORY, parser, write

sys.path.insert(0, str(REPOSITORY / "tests"))

from soaking.episode import NATIVE, Episode, Violation
from soaking.figures import Figures
from soaking.scenes import SCENES, Scene, Trees, present

TREES = 0.5
"""Share of the steps that random trees have."""
STEPS_OF_TREE, STEPS_OF_SCENE = 200, 1000
"""Steps of an episode."""
HUNG = 120.0
"""Seconds after which an episode that takes no step is given up."""


@dataclass(frozen=True)
class Mix:
    """What the episodes are drawn from, which with a seed says all of one."""

    trees: float = TREES
    """Share of the steps in random trees."""
    native: float = NATIVE
    """Share of the episodes that the native engine may take."""

    def episode(self, seed: int) -> tuple[Scene | Trees, int]:
        """Return the scene of a seed and how many steps it takes there.

        A scene that is not at hand gives way to a tree.
        """
        rng = np.random.default_rng([seed])
        whole = self.trees * STEPS_OF_SCENE + (1.0 - self.trees) * STEPS_OF_TREE
        shares = np.array([scene.share for scene in SCENES])
        scene = SCENES[rng.choice(len(SCENES), p=shares / shares.sum())]
        if rng.random() * whole < self.trees * STEPS_OF_SCENE or scene not in present():
            return Trees(), STEPS_OF_TREE
        return scene, STEPS_OF_SCENE

    def again(self, seed: int) -> str:
        """Return the command that runs an episode."""
        shares = {"trees": (self.trees, TREES), "native": (self.native, NATIVE)}
        others = [f" --{name} {own}" for name, (own, usual) in shares.items() if own != usual]
        return f"bench/soak.py --episode {seed}{''.join(others)}"


@dataclass
class Report:
    """What a worker has to say after an episode, or on its way."""

    seed: int
    taken: int
    """Steps so far."""
    figures: Figures | None = None
    """Of the whole episode, at its end."""
    broken: str = ""
    """What was broken, and how."""
    memory: float = 0.0
    """MB of the worker."""


def resident() -> float:
    """Return the memory of this process in MB, 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return 0.0
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def walk(mix: Mix, seed: int, most: int, folder: Path) -> Iterator[Report]:
    """Take the steps of an episode; yield a report now and then, the last one with the figures."""
    (scene, steps), figures, broken = mix.episode(seed), Figures(), ""
    figures.scenes[scene.name] += 0
    try:
        episode = Episode(scene, seed, folder, mix.native)
        figures.refused = episode.refused
        said = time.monotonic()
        for taken in episode.run(min(steps, most), figures, True):
            if time.monotonic() > said + 1.0:
                said = time.monotonic()
                yield Report(seed, taken)
    except Violation as violation:
        broken = f"{mix.again(seed)}: {violation}"
    yield Report(seed, figures.steps, figures, broken, resident())


def work(mix: Mix, pipe: Connection, folder: Path) -> None:
    """Run the episodes whose seeds and lengths come in, until None does."""
    while (job := pipe.recv()) is not None:
        seed, most = job
        for report in walk(mix, seed, most, folder):
            pipe.send(report)


@dataclass
class Worker:
    """A process that runs episodes, and the one that it is at."""

    mix: Mix
    folder: Path
    job: tuple[int, int] | None = None
    heard: float = 0.0
    memory: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        context = mp.get_context("spawn")
        self.pipe, other = context.Pipe()
        self._process = context.Process(target=work, args=(self.mix, other, self.folder))
        self._process.start()
        other.close()

    def give(self, job: tuple[int, int] | None) -> None:
        """Have an episode run, or the process end."""
        self.job, self.heard = job, time.monotonic()
        with suppress(OSError):
            self.pipe.send(job)

    def end(self) -> int | None:
        """End the process; return how it ended by itself, if it did."""
        self._process.join(1.0)
        code = self._process.exitcode
        self._process.kill()
        self._process.join()
        return code


class Soak:
    """Hands episodes to workers, and keeps count."""

    def __init__(self, mix: Mix, steps: int, seed: int, workers: int):
        self._mix, self._count, self._first = mix, workers, seed
        self._jobs = self._planned(steps, seed)
        self.figures = Figures()
        self.broken = self.episodes = 0
        self._memory: list[tuple[float, float]] = []

    def _planned(self, steps: int, seed: int) -> Iterator[tuple[int, int]]:
        """Yield the seeds and lengths of episodes that make up a number of steps."""
        while steps > 0:
            count = min(self._mix.episode(seed)[1], steps)
            yield seed, count
            seed, steps = seed + 1, steps - count

    def run(self, progress: Progress, total: int) -> dict[str, Any]:
        """Return the figures of all steps, or of those so far after an interrupt (Ctrl-C)."""
        task, begin = progress.add_task("soak", total=total), time.perf_counter()
        with TemporaryDirectory() as folder, suppress(KeyboardInterrupt):
            workers: list[Worker] = []
            try:
                workers = [self._hired(Path(folder)) for _ in range(self._count)]
                while any(worker.job for worker in workers):
                    workers = [self._watched(worker, Path(folder), progress) for worker in workers]
                    wait([worker.pipe for worker in workers if worker.job], timeout=5.0)
                    progress.update(task, completed=self.figures.steps)
            finally:
                for worker in workers:
                    self._dismissed(worker)
        return self._summary(time.perf_counter() - begin)

    def _hired(self, folder: Path) -> Worker:
        worker = Worker(self._mix, folder)
        worker.give(next(self._jobs, None))
        return worker

    def _dismissed(self, worker: Worker) -> int | None:
        """End a worker, and note how its memory grew since the first tenth of its episodes."""
        if worker.memory:
            self._memory.append((worker.memory[len(worker.memory) // 10], worker.memory[-1]))
        return worker.end()

    def _watched(self, worker: Worker, folder: Path, progress: Progress) -> Worker:
        """Hear a worker; return it, or another one in its place where it has died or hangs."""
        if worker.job is None:
            return worker
        seed, died = worker.job[0], False
        try:
            while worker.pipe.poll():
                worker.heard = time.monotonic()
                report = worker.pipe.recv()
                if report.figures is not None:
                    self._note(report, progress)
                    worker.memory.append(report.memory)
                    worker.give(next(self._jobs, None))
        except (EOFError, OSError):
            died = True
        if worker.job is None or not (died or time.monotonic() - worker.heard > HUNG):
            return worker
        code = self._dismissed(worker)
        said = f"the process died, exit code {code}" if died else f"no step in {HUNG:g} s"
        self._note(Report(seed, 0, Figures(), f"{self._mix.again(seed)}: {said}"), progress)
        return self._hired(folder)

    def _note(self, report: Report, progress: Progress) -> None:
        assert report.figures is not None
        self.episodes += 1
        self.figures.join(report.figures)
        if report.broken:
            self.broken += 1
            progress.console.print(report.broken, highlight=False, soft_wrap=True, markup=False)

    def _summary(self, seconds: float) -> dict[str, Any]:
        found = self.figures
        late, again = found.late
        return {
            "steps": found.steps,
            "episodes": self.episodes,
            "seeds": [self._first, self._first + self.episodes - 1],
            "scenes": dict(sorted(found.scenes.items())),
            "engines": dict(sorted(found.engines.items())),
            "refused_configurations": found.refused,
            "statuses": dict(found.statuses.most_common()),
            "braking_steps": found.braking,
            "broken_promises": self.broken,
            "worst": {kind: float(f"{x:.3g}") for kind, x in sorted(found.worst.items())},
            "largest_kkt": float(f"{found.kkt:.3g}"),
            "memory_growth_mb": round(sum(last - first for first, last in self._memory), 1),
            "slowest_step": {
                engine: {"ms": round(1e3 * slowest, 1), "again": how}
                for engine, (slowest, how) in sorted(found.slowest.items())
            },
            "latest_beyond_deadline": {"ms": round(1e3 * late, 1), "again": again}
            if again
            else None,
            "steps_per_second": round(found.steps / seconds),
        }


def once(scene: Scene | Trees, seed: int, steps: int, native: float, kept: Path | None) -> int:
    """Take the steps of one episode in this process; its scene stays in a folder, if one is given.

    Return 1 if a promise was broken.
    """
    figures = Figures()
    with TemporaryDirectory() as folder:
        try:
            for _ in Episode(scene, seed, kept or Path(folder), native).run(steps, figures, True):
                pass
        except Violation as broken:
            print(broken)
            return 1
    print(f"{figures.steps} steps of {scene.name}: no promise broken")
    return 0


def main() -> None:
    """Run the soak, print its figures, and exit with 1 if a promise was broken."""
    command = parser(__doc__)
    command.add_argument(
        "--steps", type=int, help="of all episodes, or of the one that is asked for"
    )
    command.add_argument("--seed", type=int, default=0, help="of the first episode")
    command.add_argument("--workers", type=int, default=1, help="processes; the steps are the same")
    command.add_argument("--trees", type=float, default=TREES, help="share of the steps in trees")
    command.add_argument("--native", type=float, default=NATIVE, help="share of the native engine")
    command.add_argument("--episode", type=int, metavar="SEED", help="this episode alone")
    command.add_argument("--scene", help="one episode of this scene alone, or of `trees`")
    command.add_argument("--folder", type=Path, help="where the scene of one episode is kept")
    arguments = command.parse_args()
    mix = Mix(arguments.trees, arguments.native)
    if arguments.episode is not None:
        scene, steps = mix.episode(arguments.episode)
        count, folder = arguments.steps or steps, arguments.folder
        sys.exit(once(scene, arguments.episode, count, mix.native, folder))
    if arguments.scene:
        scene = next(each for each in (Trees(), *present()) if each.name == arguments.scene)
        steps = arguments.steps or STEPS_OF_SCENE
        sys.exit(once(scene, arguments.seed, steps, mix.native, arguments.folder))
    total = arguments.steps or 1_000_000
    soak = Soak(mix, total, arguments.seed, arguments.workers)
    with Progress(disable=not sys.stdout.isatty()) as progress:
        figures = soak.run(progress, total)
    print(json.dumps(figures, indent=2))
    write(arguments.json, "soak", figures)
    sys.exit(1 if figures["broken_promises"] else 0)


if __name__ == "__main__":
    main()
