"""The slowest steps of hard problems, with a deadline and without, in their thread's own time.

Robots with all pairs of geoms kept apart jump to places at random, overlapping ones among them,
with targets near, far and out of reach. The walk is taken several times, the same inputs each time,
and the least time of each step counts: a step is slow that is slow by itself, and not by what else
the machine did. Beside it stands what the rows alone take at the same places: no deadline cuts that
short. `--json FILE` writes the figures under `slowest`.
"""

import gc
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rmrc
from timing import REPOSITORY, machine, parser, write

sys.path.insert(0, str(REPOSITORY / "tests"))

from slow_steps import CASES, Place, problem, walk

Times = NDArray[np.float64]

PASSES = 3
DEADLINE = 900.0  # µs


def own_times(controller: rmrc.Controller, places: list[Place]) -> tuple[Times, Counter[str]]:
    """Return the least times of all steps in µs, and the statuses of the last pass."""
    least, clock = np.full(len(places), np.inf), time.thread_time
    statuses: Counter[str] = Counter()
    for _ in range(PASSES):
        controller.reset()
        statuses.clear()
        for k, place in enumerate(places):
            for name, target in place.targets.items():
                controller.set_target(name, *target)
            begin = clock()
            step = controller.step(place.q)
            least[k] = min(least[k], 1e6 * (clock() - begin))
            statuses[step.status.name] += 1
    return least, statuses


def row_times(made: rmrc.Problem, places: list[Place]) -> Times:
    """Return what the rows take in µs at all places, the least of as many passes."""
    least, clock = np.full(len(places), np.inf), time.thread_time
    for _ in range(PASSES):
        engine: Any = rmrc.Controller(made, "native").engine
        for k, place in enumerate(places):
            engine.evaluation.v_previous[:] = 0.0
            engine._assemble(place.q, made.dt)
            qp = engine._assembly.qp
            begin = clock()
            engine._rows.native.update(qp.lb, qp.ub, made.dt)
            least[k] = min(least[k], 1e6 * (clock() - begin))
    return least


def figures(times: Times) -> dict[str, float]:
    """Return median, tail and the largest in µs."""
    median, tail = np.percentile(times, [50.0, 99.0])
    return {
        "median_us": round(float(median), 1),
        "p99_us": round(float(tail), 1),
        "max_us": round(float(times.max()), 1),
    }


def measured(case: str, folder: Path, steps: int, engine: Any) -> dict[str, Any]:
    """Return the figures of a case."""
    made = problem(case, folder)
    places = list(walk(made, steps))
    rows, found = row_times(made, places), {}
    found["rows"] = figures(rows)
    for name, deadline in (("no_deadline", None), ("deadline", DEADLINE)):
        controller = rmrc.Controller(problem(case, folder, deadline), engine)
        times, statuses = own_times(controller, places)
        found[name] = {**figures(times), "statuses": dict(statuses)}
    found["beyond_us"] = round(float((times - DEADLINE - 2.0 * rows).max()), 1)
    return found


def main() -> None:
    """Measure all cases, and print them."""
    command = parser(__doc__)
    command.add_argument("--steps", type=int, default=2000)
    command.add_argument("--case", choices=CASES, action="append")
    command.add_argument("--engine", choices=("native", "python"), default="native")
    arguments = command.parse_args()
    print(f"machine: {machine()}; {arguments.steps} steps, the least of {PASSES}; times in µs")
    print(f"{'':18} {'rows':>16} {'no deadline':>26} {f'{DEADLINE:g} µs':>26} {'beyond':>8}")
    found: dict[str, Any] = {"steps": arguments.steps, "deadline_us": DEADLINE}
    gc.disable()
    with TemporaryDirectory() as folder:
        for case in arguments.case or CASES:
            row = found[case] = measured(case, Path(folder), arguments.steps, arguments.engine)
            rows, free, bound = row["rows"], row["no_deadline"], row["deadline"]
            print(
                f"{case:18} {rows['median_us']:7.0f} {rows['max_us']:8.0f}"
                f" {free['median_us']:8.0f} {free['p99_us']:8.0f} {free['max_us']:8.0f}"
                f" {bound['median_us']:8.0f} {bound['p99_us']:8.0f} {bound['max_us']:8.0f}"
                f" {row['beyond_us']:8.0f}  {bound['statuses']}",
                flush=True,
            )
    write(arguments.json, "slowest", found)


if __name__ == "__main__":
    main()
