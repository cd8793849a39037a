"""The whole step beside the peers': set the targets, solve, integrate; short turns of each.

All sides have the same robot, tasks, weights, gains, limits and dt, each in a process and an
environment of its own (`bench/peers/environments.py` makes them), on one core. mink and pink run
with the fastest of their backends that are installed, and our Python engine runs beside the engine
that `auto` takes. `panda` and `g1` are read by MuJoCo and by Pinocchio from the same URDF, without
geoms; `panda, geoms` is scenes/panda.xml, and the others are of the Menagerie, which Pinocchio does
not read. Where placo differs says `peers/with_placo.py`.
Where the targets will be is known before: what is timed is the work of the sides, not of this file.
Nothing is printed of a case whose sides have not come to the same configuration.
Prints medians, p99, p99.9 and how many times rmrc's median a peer's is; `--json FILE` writes them
under `step`, with the median of the first step of a turn, on cold caches, as `cold_us`.
"""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

from cases import ALOHA, COLLISION, DT, G1, PANDA, Case, prepare
from peers.descriptions import ROBOT
from rmrc.errors import RmrcError
from sides import SIDES, compare, environment
from timing import COLD, RUN, machine, parser, turns, write

WARM_UP, STEPS, LONG = 500, 5000, 100_000
SAME_Q = 1e-5
"""How far apart the sides' last configurations may be, rad or m; placo's tasks differ by 2e-6."""

BENT = {"panda_joint2": -0.3, "panda_joint4": -2.0, "panda_joint6": 1.8, "panda_joint7": 0.7}
CROUCHED = {
    f"{side}_{joint}_joint": angle
    for side in ("left", "right")
    for joint, angle in {
        "hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3, "shoulder_pitch": 0.3, "elbow": 0.5,
    }.items()
}  # fmt: skip
G1_LINKS = (
    "left_ankle_roll_link",
    "right_ankle_roll_link",
    "left_rubber_hand",
    "right_rubber_hand",
    "torso_link",
)

CASES = (
    Case("panda", "panda", (("body", "panda_hand_tcp"),), others={"start": BENT}),
    Case(
        "g1", "g1", tuple(("body", link) for link in G1_LINKS), com=True,
        others={"start": CROUCHED},
    ),
    dataclasses.replace(PANDA, name="panda, geoms"),
    dataclasses.replace(G1, name="g1, geoms"),
    dataclasses.replace(
        ALOHA, name="aloha, collision", others=ALOHA.others | {"limits": COLLISION}
    ),
)  # fmt: skip
ALL = tuple(SIDES)
MUJOCO = ("rmrc", "python", "mink")
"""The sides that read a MuJoCo model."""


def measure(case: Case, warm_up: int, steps: int) -> dict[str, Any]:
    """Return what the sides that are here took for a case.

    Raises:
        RmrcError, FileNotFoundError: If the robot is not at hand.
        SystemExit: If the sides have not done the same work.
    """
    sides = ALL if case.scene in ROBOT else MUJOCO
    here = [side for side in sides if environment(side).exists()]
    with tempfile.TemporaryDirectory() as folder:
        problem, work = prepare(case, Path(folder), turns(warm_up, steps) * (COLD + RUN))
        found = compare(here, work, warm_up, steps)
    for side, row in found.items():
        if row["apart"] > SAME_Q:
            raise SystemExit(f"{case.name}: {side} is {row['apart']:.1e} apart: not the same work")
    return {
        "case": case.name,
        "nv": problem.model.nv,
        "tasks": case.tasks,
        "absent": [side for side in sides if side not in here],
        "sides": {side: row | ratio(row, found["rmrc"]) for side, row in found.items()},
    }


def ratio(row: dict[str, Any], ours: dict[str, Any]) -> dict[str, float]:
    """Return how many times rmrc's a side's median is."""
    return {"times_rmrc": round(row["median_us"] / ours["median_us"], 2)}


def tail() -> dict[str, Any]:
    """Return the figures of rmrc's step of the Panda over many more steps."""
    with tempfile.TemporaryDirectory() as folder:
        _, work = prepare(CASES[0], Path(folder), turns(WARM_UP, LONG) * (COLD + RUN))
        found = compare(["rmrc"], work, WARM_UP, LONG)["rmrc"]
    return {"case": CASES[0].name, "steps": LONG, **found}


def main() -> None:
    """Run every case whose robot is at hand, and print a row for each side."""
    command = parser(__doc__)
    command.add_argument("--steps", type=int, default=STEPS, help="steps that are timed")
    arguments = command.parse_args()
    print(f"machine: {machine()}; dt {DT * 1e3:g} ms, {WARM_UP} + {arguments.steps} steps")
    print(f"{'case':16} {'nv':>3} {'tasks':>5} {'side':>7} {'median µs':>9} {'p99':>8} {'p99.9':>8}"
          f" {'× rmrc':>7}  solver")  # fmt: skip
    rows = []
    for case in CASES:
        try:
            row = measure(case, WARM_UP, arguments.steps)
        except (RmrcError, FileNotFoundError) as absent:
            print(f"{case.name:16} skipped: {absent}")
            continue
        rows.append(row)
        for side, each in row["sides"].items():
            print(
                f"{row['case']:16} {row['nv']:3} {row['tasks']:5} {side:>7}"
                f" {each['median_us']:9.1f} {each['p99_us']:8.1f} {each['p99.9_us']:8.1f}"
                f" {each['times_rmrc']:7.2f}  {each['solver']}"
            )
        for side in row["absent"]:
            print(f"{row['case']:16} {side:>17} is left out: it has no environment")
    long = tail() if rows and rows[0]["case"] == CASES[0].name else {}
    if long:
        share = long["p99.9_us"] / long["median_us"]
        print(f"{long['case']} over {LONG:,} steps: p99.9 is {share:.1f} times the median")
    write(arguments.json, "step", {"rows": rows, "long": long})


if __name__ == "__main__":
    main()
