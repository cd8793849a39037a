"""One row a method: the time of a step on the Panda, in short runs that alternate.

Every method has the same robot, target and dt; those that take weights, a metric or a second level
have them. Prints median and p99, and the ratio to `qp`.
"""

import time
from pathlib import Path

import numpy as np

import rmrc
from rmrc.engine.closed_form import METHODS

SCENE = str(Path(__file__).resolve().parent.parent / "scenes" / "panda.xml")
WARM_UP, STEPS, RUN = 500, 3000, 50


def controller(method: str, **others: object) -> rmrc.Controller:
    """Return a controller of a method: a frame task, and a posture below it."""
    tasks = [
        {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
        {"name": "posture", "type": "posture", "level": 1, "B": 0.01},
    ]
    if method == "inverse":  # as many rows as dofs
        others["dofs"] = [f"joint{k}" for k in range(1, 7)]
    metric = 1e-3 if method == "weighted" else 0.0
    return rmrc.Controller(
        rmrc.compile(
            rmrc.Config.model_validate(
                {"scene": SCENE, "method": method, "metric": metric, "tasks": tasks, **others}
            )
        )
    )


def main() -> None:
    """Time the methods and print the table."""
    rows = {"qp": controller("qp"), "qp, strict": controller("qp", priority="strict")}
    rows |= {method: controller(method) for method in METHODS}
    times = {name: np.empty(WARM_UP + STEPS) for name in rows}
    phase = 2 * np.pi * np.arange(WARM_UP + STEPS) / 2000.0
    offsets = 0.03 * np.stack([np.sin(phase), np.sin(2 * phase), np.cos(phase) - 1], axis=1)
    poses = {name: c.problem.term["hand"].target.copy() for name, c in rows.items()}
    for begin in range(0, WARM_UP + STEPS, RUN):
        for name, each in rows.items():
            pose = poses[name]
            for k in range(begin, begin + RUN):
                start = time.perf_counter_ns()
                each.set_target("hand", pose[4:] + offsets[k], pose[:4])
                each.step()
                times[name][k] = (time.perf_counter_ns() - start) / 1e3
    reference = np.median(times["qp"][WARM_UP:])
    print(f"{'method':12} {'median µs':>9} {'p99':>8} {'of qp':>6}")
    for name, taken in times.items():
        median, p99 = np.median(taken[WARM_UP:]), np.percentile(taken[WARM_UP:], 99)
        print(f"{name:12} {median:9.1f} {p99:8.1f} {median / reference:6.2f}")


if __name__ == "__main__":
    main()
