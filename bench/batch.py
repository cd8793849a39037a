"""Steps of thousands of controllers at once, on one thread and on two, beside one controller.

Each side in turn takes a step of all 4,096 elements; the single controller takes 4,096 steps in a
loop. All have the Panda with a frame task and a posture, and targets scattered around the hand.
Two cores need not be equally fast, least of all those of a virtual machine, and the scheduler gives
a single thread the faster one. So one thread has its turn on each of them, and what two threads do
in a second is compared with the mean of the two. Prints steps per second and that ratio;
`--json FILE` writes them under `batch`.
"""

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import rmrc
from timing import REPOSITORY, machine, parser, write

ELEMENTS = 4096
WARM_UP, ROUNDS = 10, 200
NAMES = ("one_thread", "one_thread_second_core", "two_threads", "controller")
DT = 0.002
SPREAD = 0.2  # m, of the targets around the hand
CONFIG: dict[str, Any] = {
    "scene": str(REPOSITORY / "scenes" / "panda.xml"),
    "dt": DT,
    "damping": {"lambda": 0.01},
    "tasks": [
        {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
        {"name": "posture", "type": "posture", "B": 1e-4},
    ],
}


def loop(controller: rmrc.Controller) -> None:
    """Take as many steps of one controller as there are elements."""
    step = controller.step
    for _ in range(ELEMENTS):
        step()


def cores() -> list[set[int]]:
    """Return the first two cores that this process may use; nothing where that is not known."""
    if not hasattr(os, "sched_getaffinity"):
        return [set(), set()]
    here = sorted(os.sched_getaffinity(0))
    return [{here[0]}, {here[-1]}]


def taken(sides: Sequence[tuple[Callable[[], object], set[int]]]) -> np.ndarray:
    """Return the times (rounds, sides) in s of sides that take turns, each on its cores."""
    times = np.empty((WARM_UP + ROUNDS, len(sides)))
    for row in times:
        for k, (side, on) in enumerate(sides):
            if on:
                os.sched_setaffinity(0, on)  # of this thread alone
            begin = time.perf_counter()
            side()
            row[k] = time.perf_counter() - begin
    return times[WARM_UP:]


def measure() -> dict[str, Any]:
    """Return the figures of all sides."""
    problem = rmrc.compile(rmrc.Config.model_validate(CONFIG))
    batches = [rmrc.BatchController(problem, ELEMENTS, threads=threads) for threads in (1, 2)]
    controller = rmrc.Controller(problem)
    hand = problem.term["hand"].target
    poses = np.tile(np.concatenate([hand[4:], hand[:4]]), (ELEMENTS, 1))
    poses[:, :3] += np.random.default_rng(0).uniform(-SPREAD, SPREAD, (ELEMENTS, 3))
    for batch in batches:
        batch.set_targets("hand", poses)
    controller.set_target("hand", poses[0, :3], poses[0, 3:])
    first, second = cores()
    both = first | second
    sides = [
        (batches[0].step, first),
        (batches[0].step, second),
        (batches[1].step, both),
        (lambda: loop(controller), both),
    ]
    times = taken(sides)
    # All must have done the same work, or the times say nothing; one thread has taken it twice.
    for _ in range(WARM_UP + ROUNDS):
        batches[1].step()
    if not np.array_equal(batches[0].q, batches[1].q):
        raise SystemExit("two threads have taken other steps than one")
    median, least = np.median(times, axis=0), times.min(axis=0)
    found: dict[str, Any] = {"elements": ELEMENTS, "rounds": ROUNDS, "engine": batches[0].engine}
    for k, name in enumerate(NAMES):
        found[f"{name}_median_per_s"] = round(ELEMENTS / median[k])
        found[f"{name}_best_per_s"] = round(ELEMENTS / least[k])
    rates = 1.0 / times
    ratio = rates[:, 2] / (0.5 * (rates[:, 0] + rates[:, 1]))
    return found | {
        "ratio_median": round(float(np.median(ratio)), 2),
        "ratio_best": round(float(least[:2].mean() / least[2]), 2),
        "load": [round(load, 1) for load in os.getloadavg()],
    }


def main() -> None:
    """Run all sides and print a row for each."""
    arguments = parser(__doc__).parse_args()
    print(f"machine: {machine()}; {WARM_UP} + {ROUNDS} rounds of {ELEMENTS} steps")
    found = measure()
    print(f"{'':22} {'median 1/s':>12} {'best 1/s':>12}")
    for name in NAMES:
        median, best = found[f"{name}_median_per_s"], found[f"{name}_best_per_s"]
        print(f"{name.replace('_', ' '):22} {median:12,} {best:12,}")
    print(
        f"two threads are {found['ratio_median']} times as fast as one by the median,"
        f" {found['ratio_best']} by the best; load {found['load'][0]}"
    )
    write(arguments.json, "batch", found)


if __name__ == "__main__":
    main()
