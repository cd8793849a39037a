"""How evenly a Panda's steps come, 100,000 of them, and what Python adds to the work in C++.

A step is set_target, step and a look at its v. The run is taken several times from the same start,
bit by bit the same, so that the least time of each step is the code's own and what differs from it
is the machine's: its clock ticks, and other processes. It is taken as Python is, and as a real-time
loop would have it, with the garbage collector off. The work in C++ is that of an element of a
`BatchController` on one thread, which is a step and 4 % for the element's state.
`--json FILE` writes the figures under `jitter`.
"""

import gc
import os
import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rmrc
from batch import CONFIG, DT
from timing import machine, parser, write

STEPS, PASSES = 100_000, 5
ELEMENTS, ROUNDS = 256, 200  # of the batch: few enough for the cache
AMPLITUDE = 0.03  # m, of the target's motion
SLOW = 3.0  # medians above which a step is slow


Targets = tuple[list[np.ndarray], np.ndarray]


def targets(problem: rmrc.Problem) -> Targets:
    """Return the hand's positions on a slow figure, and its quaternion."""
    phase = 2 * np.pi * np.arange(STEPS) * DT / 4.0
    figure = np.stack([np.sin(phase), np.sin(2 * phase), np.cos(phase) - 1], axis=1)
    hand = problem.term["hand"].target
    return list(hand[4:] + AMPLITUDE * figure), hand[:4].copy()


def once(controller: rmrc.Controller, given: Targets, times: NDArray[np.int64]) -> None:
    """Write the times in ns of the whole run."""
    positions, quaternion = given
    set_target, step, clock = controller.set_target, controller.step, time.perf_counter_ns
    controller.reset()
    for k, position in enumerate(positions):
        begin = clock()
        set_target("hand", position, quaternion)
        _ = step().v
        times[k] = clock() - begin


def evenness(controller: rmrc.Controller) -> dict[str, Any]:
    """Return medians and tails in µs: of one run, the calmest, and of each step's least time."""
    times, given = np.ones((PASSES, STEPS), dtype=np.int64), targets(controller.problem)
    once(controller, given, times[0])  # warm up
    before, collected = resource.getrusage(resource.RUSAGE_SELF), collections()
    for row in times:
        once(controller, given, row)
    after = resource.getrusage(resource.RUSAGE_SELF)
    tails = np.percentile(times, 99.9, axis=1)
    return {
        "one_run": figures(times[tails.argmin()]),
        "own": figures(times.min(axis=0)),
        "collections": collections() - collected,
        "page_faults": after.ru_minflt - before.ru_minflt,
        "preempted": after.ru_nivcsw - before.ru_nivcsw,
    }


def collections() -> int:
    """Return how often the garbage collector has run."""
    return sum(generation["collections"] for generation in gc.get_stats())


def figures(times: NDArray[np.int64]) -> dict[str, float]:
    """Return median, tails and the largest in µs, and the share of slow steps."""
    median, p99, tail = np.percentile(times, [50, 99, 99.9]) / 1e3
    return {
        "median_us": round(float(median), 2),
        "p99_us": round(float(p99), 2),
        "p999_us": round(float(tail), 2),
        "max_us": round(float(times.max()) / 1e3, 1),
        "ratio": round(float(tail / median), 2),
        "slow_share": float(np.mean(times > SLOW * 1e3 * median)),
    }


def best(work: Callable[[], object], count: int) -> float:
    """Return the least time in µs of one of `count` things that a call does."""
    least = np.inf
    for _ in range(ROUNDS):
        begin = time.perf_counter_ns()
        work()
        least = min(least, time.perf_counter_ns() - begin)
    return least / count / 1e3


def overhead(problem: rmrc.Problem) -> dict[str, float]:
    """Return the times in µs of the parts of a step in Python, and of the work in C++."""
    controller = rmrc.Controller(problem)
    batch = rmrc.BatchController(problem, ELEMENTS, threads=1)
    positions, quaternion = targets(problem)
    positions = positions[:: STEPS // ELEMENTS][:ELEMENTS]
    poses = np.hstack([positions, np.tile(quaternion, (ELEMENTS, 1))])
    batch.set_targets("hand", poses)

    def both() -> None:
        for position in positions:
            controller.set_target("hand", position, quaternion)
            controller.step()

    def read() -> None:
        for position in positions:
            controller.set_target("hand", position, quaternion)
            _ = controller.step().v

    whole, cpp = best(both, ELEMENTS), best(batch.step, ELEMENTS)
    found = {"set_target_and_step": whole, "and_v": best(read, ELEMENTS), "cpp": cpp}
    found["overhead"] = whole - cpp
    return {f"{name}_us": round(value, 2) for name, value in found.items()}


def main() -> None:
    """Measure all, and print it."""
    arguments = parser(__doc__).parse_args()
    print(f"machine: {machine()}; {PASSES} runs of {STEPS} steps; load {os.getloadavg()[0]:.1f}")
    problem = rmrc.compile(rmrc.Config.model_validate(CONFIG))
    controller = rmrc.Controller(problem)
    found: dict[str, Any] = {"steps": STEPS, "collector on": evenness(controller)}
    gc.collect()
    gc.disable()
    found["collector off"] = evenness(controller)
    gc.enable()
    print(f"{'':26} {'median':>7} {'p99':>7} {'p99.9':>7} {'max':>9} {'ratio':>6} {'slow':>8}")
    for name in ("collector on", "collector off"):
        for of, row in (("one run", found[name]["one_run"]), ("own", found[name]["own"])):
            print(
                f"{f'{name}, {of}':26} {row['median_us']:7.2f} {row['p99_us']:7.2f}"
                f" {row['p999_us']:7.2f} {row['max_us']:9.1f} {row['ratio']:6.2f}"
                f" {row['slow_share']:8.2%}"
            )
        counts = ("collections", "page_faults", "preempted")
        print(
            "  " + ", ".join(f"{count.replace('_', ' ')} {found[name][count]}" for count in counts)
        )
    found["parts"] = overhead(problem)
    print(
        ", ".join(f"{name.replace('_', ' ')[:-3]} {us} µs" for name, us in found["parts"].items())
    )
    write(arguments.json, "jitter", found)


if __name__ == "__main__":
    main()
