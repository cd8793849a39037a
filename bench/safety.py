"""What the guarantees cost: the step with limits of acceleration, adaptive damping, collision rows.

Each row stands beside mink's step for the same scene, tasks, gains and limits, in short turns as
in `step.py`. mink has no adaptive damping and none of a stopping distance: it runs without. Its
collision limit gets the same pairs of geoms, least distance and distance of detection. Prints
medians, p99 and p99.9, with the mean number of rows of the program; `--json FILE` writes the
figures under `safety`, beside what is there.
"""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import rmrc
from cases import ALOHA, COLLISION, G1, LAMBDA, PANDA, Case, collision, offsets, prepare
from rmrc.problem.problem import Problem
from sides import compare, environment
from timing import COLD, RUN, machine, parser, turns, write

WARM_UP, STEPS = 200, 2000
ACCELERATION = {"acceleration": {"default": 15.0}}  # rad/s² or m/s²
ADAPTIVE = {"lambda": LAMBDA, "adapt": "sigma_min", "threshold": 0.05}
SIDES = ("rmrc", "mink")

GUARDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "acceleration": {"limits": ACCELERATION},
    "sigma_min": {"damping": ADAPTIVE},
}
GUARDED = (
    *((case, name, others) for case in (PANDA, G1, ALOHA) for name, others in GUARDS.items()),
    (ALOHA, "collision", {"limits": COLLISION}),
    (ALOHA, "both limits", {"limits": COLLISION | ACCELERATION}),
)
"""Cases, and the parts of their configurations that guard them."""


def measure(case: Case, name: str) -> dict[str, Any]:
    """Return both sides' times in µs."""
    with tempfile.TemporaryDirectory() as folder:
        problem, work = prepare(case, Path(folder), turns(WARM_UP, STEPS) * (COLD + RUN))
        here = [side for side in SIDES if environment(side).exists()]
        found = compare(here, work, WARM_UP, STEPS)
    return {
        "case": case.name,
        "guard": name,
        "nv": problem.model.nv,
        "pairs": len((collision(problem) or {"geom_pairs": ()})["geom_pairs"]),
        "rows": round(rows(case, problem), 1),
        "sides": found,
    }


def rows(case: Case, problem: Problem) -> float:
    """Return the mean number of rows of the program on the way that is timed."""
    controller = rmrc.Controller(problem, engine="python")
    targets = {name: problem.term[name].target.copy() for name in case.names}
    count = 0
    for move in offsets(STEPS):
        for name, pose in targets.items():
            controller.set_target(name, pose[4:] + move, pose[:4])
        controller.step()
        count += controller.engine.rows.count
    return count / STEPS


def main() -> None:
    """Run every case whose robot is at hand, and print a row for each."""
    arguments = parser(__doc__).parse_args()
    print(f"machine: {machine()}; {WARM_UP} + {STEPS} steps in turns of {RUN}")
    print(
        f"{'case':8} {'guard':14} {'pairs':>5} {'rows':>5} {'side':>5}"
        f" {'median µs':>9} {'p99':>8} {'p99.9':>8}  solver"
    )
    found = []
    for case, name, others in GUARDED:
        guarded = dataclasses.replace(case, others=case.others | others)
        try:
            row = measure(guarded, name)
        except rmrc.RmrcError as absent:
            print(f"{case.name:8} {name:14} skipped: {absent}")
            continue
        found.append(row)
        for side, each in row["sides"].items():
            print(
                f"{row['case']:8} {row['guard']:14} {row['pairs']:5} {row['rows']:5.1f} {side:>5}"
                f" {each['median_us']:9.1f} {each['p99_us']:8.1f} {each['p99.9_us']:8.1f}"
                f"  {each['solver']}"
            )
    write(arguments.json, "safety", {"rows": found})


if __name__ == "__main__":
    main()
