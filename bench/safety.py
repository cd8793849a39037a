"""What the guarantees cost: the step with limits of acceleration, adaptive damping, collision rows.

Each row stands beside mink's step for the same scene, tasks, gains and limits, in one process and
in short runs that alternate, as in `step.py`. mink has no adaptive damping and none of a stopping
distance: it runs without. Its collision limit gets the same pairs of geoms, least distance and
distance of detection. Prints medians, p99 and the ratio of the medians, with the mean number of
rows of the program; `--json FILE` writes the figures under `safety`, beside what is there.
"""

from dataclasses import dataclass
from typing import Any

import mink

import rmrc
from rmrc.problem.limits.collision import CollisionPairs
from rmrc.problem.problem import Problem
from step import CASES, LAMBDA, Case, compile_case, fastest_solver, minks, offsets, ours
from timing import RUN, alternating, figures, machine, parser, write

WARM_UP, STEPS = 200, 2000
ACCELERATION = {"acceleration": {"default": 15.0}}  # rad/s² or m/s²
ADAPTIVE = {"lambda": LAMBDA, "adapt": "sigma_min", "threshold": 0.05}
COLLISION = {"collision": {"pairs": "all", "gain": 0.85}}
"""With mink's own gain, and our distances: with its own, 5 and 10 mm, no pair would be near."""

ALOHA = Case(
    "aloha", "menagerie:aloha/scene", (("site", "left/gripper"), ("site", "right/gripper"))
)


@dataclass(frozen=True)
class Guarded:
    """A case, and the parts of its configuration that guard it."""

    case: Case
    name: str
    others: dict[str, Any]


APART = {"start": "neutral_pose"}
"""Without it the arms of ALOHA start inside each other."""

GUARDED = (
    *(
        Guarded(case, name, start | others)
        for case, start in (*((case, {}) for case in CASES), (ALOHA, APART))
        for name, others in (
            ("plain", {}),
            ("acceleration", {"limits": ACCELERATION}),
            ("sigma_min", {"damping": ADAPTIVE}),
        )
    ),
    Guarded(ALOHA, "collision", APART | {"limits": COLLISION}),
    Guarded(ALOHA, "both limits", APART | {"limits": COLLISION | ACCELERATION}),
)


def collision_limits(problem: Problem) -> tuple[list[mink.Limit], int]:
    """Return mink's collision limit for our pairs, and how many there are."""
    found: list[mink.Limit] = []
    pairs = 0
    for limit in problem.barriers:
        if isinstance(limit, CollisionPairs):
            geoms = [([a], [b]) for a, b in limit.geoms.tolist()]
            found.append(
                mink.CollisionAvoidanceLimit(
                    problem.model,
                    geoms,
                    gain=limit.gain,
                    minimum_distance_from_collisions=limit.d_min,
                    collision_detection_distance=limit.detect,
                )
            )
            pairs += len(geoms)
    return found, pairs


def measure(guarded: Guarded) -> dict[str, Any]:
    """Return both sides' times in µs over alternating steps."""
    case, problem = guarded.case, compile_case(guarded.case, **guarded.others)
    more, pairs = collision_limits(problem)
    solver, moves = fastest_solver(case, problem, more), offsets(WARM_UP + STEPS)
    controller = rmrc.Controller(problem)
    sides = (ours(case, controller, moves), minks(case, problem, solver, moves, more))
    return {
        "case": case.name,
        "guard": guarded.name,
        "nv": problem.model.nv,
        "pairs": pairs,
        "rows": round(rows(case, problem), 1),
        "engine": controller.engine.name,
        "mink_solver": solver,
        **figures(("rmrc", "mink"), alternating(sides, WARM_UP, STEPS)),
    }


def rows(case: Case, problem: Problem) -> float:
    """Return the mean number of rows of the program on the way that is timed."""
    controller = rmrc.Controller(problem, engine="python")
    step, count = ours(case, controller, offsets(STEPS)), 0
    for k in range(STEPS):
        step(k)
        count += controller.engine.rows.count
    return count / STEPS


def main() -> None:
    """Run every case whose robot is at hand, and print a row for each."""
    arguments = parser(__doc__).parse_args()
    print(f"machine: {machine()}; {WARM_UP} + {STEPS} steps in runs of {RUN}")
    print(f"{'case':8} {'guard':14} {'pairs':>5} {'rows':>5} {'rmrc µs':>9} {'p99':>8}"
          f" {'mink µs':>9} {'p99':>8} {'ratio':>6}  mink's solver")  # fmt: skip
    found = []
    for guarded in GUARDED:
        try:
            row = measure(guarded)
        except rmrc.RmrcError as absent:
            print(f"{guarded.case.name:8} {guarded.name:14} skipped: {absent}")
            continue
        found.append(row)
        print(
            f"{row['case']:8} {row['guard']:14} {row['pairs']:5} {row['rows']:5.1f}"
            f" {row['rmrc_median_us']:9.1f} {row['rmrc_p99_us']:8.1f}"
            f" {row['mink_median_us']:9.1f} {row['mink_p99_us']:8.1f}"
            f" {row['ratio']:6.2f}  {row['mink_solver']}"
        )
    write(arguments.json, "safety", {"rows": found})


if __name__ == "__main__":
    main()
