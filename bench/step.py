"""The whole step beside mink's: set the targets, solve, integrate; short runs, alternating.

Both have the same robot, tasks, weights, limits and dt, in one process. mink runs with the fastest
of its backends that are installed, and our Python engine runs beside the one that `auto` takes.
Where the targets will be is known before: what is timed is the work of the sides, not of this file.
Prints medians, p99 and the ratio of the medians; `--json FILE` writes them under `step`.
`make bench` keeps BLAS to one thread: at this size more threads only add noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mink
import mujoco
import numpy as np
import qpsolvers

import rmrc
from rmrc.problem.limits.joints import HINGE_SPEED
from rmrc.problem.problem import Problem
from timing import REPOSITORY, RUN, StepOf, alternating, figures, machine, parser, timed, write

DT = 0.002
GAIN = 0.02  # mink's, per step; ours is GAIN / DT in 1/s
LAMBDA = 0.01
WARM_UP, STEPS = 500, 5000
AMPLITUDE = 0.03  # m, of the targets' motion


@dataclass(frozen=True)
class Case:
    """A robot and its tasks."""

    name: str
    scene: str
    frames: tuple[tuple[str, str], ...]
    com: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the tasks on the frames."""
        return [name.replace("/", "_") for _, name in self.frames]

    @property
    def tasks(self) -> int:
        """Number of tasks, the posture included."""
        return len(self.frames) + self.com + 1


CASES = (
    Case("panda", str(REPOSITORY / "scenes" / "panda.xml"), (("site", "hand"),)),
    Case(
        "g1",
        "menagerie:unitree_g1/g1",
        (
            ("site", "left_foot"),
            ("site", "right_foot"),
            ("site", "left_palm"),
            ("site", "right_palm"),
            ("body", "torso_link"),
            ("site", "head"),
        ),
        com=True,
    ),
)


def compile_case(case: Case, **others: Any) -> Problem:
    """Return the problem of a case, with other parts of its configuration."""
    gain = GAIN / DT
    tasks: list[dict[str, Any]] = [
        {"name": name, "type": "frame", "frame": {kind: frame}, "gain": gain}
        for (kind, frame), name in zip(case.frames, case.names, strict=True)
    ]
    if case.com:
        tasks.append({"name": "com", "type": "com", "gain": gain})
    tasks.append({"name": "posture", "type": "posture", "B": 1e-4, "gain": gain})
    return rmrc.compile(
        rmrc.Config.model_validate(
            {"scene": case.scene, "dt": DT, "damping": {"lambda": LAMBDA}, "tasks": tasks} | others
        )
    )


def ours(case: Case, controller: rmrc.Controller, moves: np.ndarray) -> StepOf:
    """Return step k of rmrc's, with its targets moved by moves[k]: configuration out."""
    problem = controller.problem
    targets = [(name, problem.term[name].target) for name in case.names]
    poses = [(name, list(target[4:] + moves), target[:4].copy()) for name, target in targets]
    points = list(problem.term["com"].target + moves) if case.com else None

    def step(k: int) -> np.ndarray:
        for name, positions, quaternion in poses:
            controller.set_target(name, positions[k], quaternion)
        if points is not None:
            controller.set_target("com", points[k])
        return controller.step().q

    return step


def minks(
    case: Case, problem: Problem, solver: str, moves: np.ndarray, more: Sequence[mink.Limit] = ()
) -> StepOf:
    """Return step k of mink's for the same work, with more limits if there are any."""
    model = problem.model
    configuration = mink.Configuration(model, problem.start)
    frames = [mink.FrameTask(name, kind, 1.0, 1.0, gain=GAIN) for kind, name in case.frames]
    posture = mink.PostureTask(model, cost=1e-2, gain=GAIN)
    posture.set_target(problem.start)
    tasks: list[mink.Task] = [*frames, posture]
    still = np.zeros((len(moves), 4))
    poses = [
        [mink.SE3(pose) for pose in problem.term[name].target + np.hstack([still, moves])]
        for name in case.names
    ]
    com = mink.ComTask(1.0, gain=GAIN)
    points = list(problem.term["com"].target + moves) if case.com else []
    if case.com:
        tasks.append(com)
    joints = [
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    ]
    limits: list[mink.Limit] = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, dict.fromkeys(joints, HINGE_SPEED)),
        *more,
    ]

    def step(k: int) -> np.ndarray:
        for task, targets in zip(frames, poses, strict=True):
            task.set_target(targets[k])
        if points:
            com.set_target(points[k])
        v = mink.solve_ik(configuration, tasks, DT, solver, LAMBDA**2, limits=limits)
        configuration.integrate_inplace(v, DT)
        return configuration.q

    return step


def offsets(steps: int) -> np.ndarray:
    """Return how far the targets are displaced at each step: a slow figure, the same for both."""
    phase = 2 * np.pi * np.arange(steps) * DT / 4.0
    return AMPLITUDE * np.stack([np.sin(phase), np.sin(2 * phase), np.cos(phase) - 1], axis=1)


def fastest_solver(case: Case, problem: Problem, more: Sequence[mink.Limit] = ()) -> str:
    """Return mink's fastest backend here for a case."""
    medians, moves = {}, offsets(300)
    for solver in ("daqp", "proxqp", "quadprog", "osqp"):
        if solver in qpsolvers.available_solvers:
            step = minks(case, problem, solver, moves, more)
            medians[solver] = np.median([timed(step, k) for k in range(len(moves))][100:])
    return min(medians, key=lambda solver: medians[solver])


def measure(case: Case) -> dict[str, Any]:
    """Return all sides' times in µs over alternating steps."""
    problem, moves = compile_case(case), offsets(WARM_UP + STEPS)
    solver = fastest_solver(case, problem)
    controller = rmrc.Controller(problem)
    sides = (
        ours(case, controller, moves),
        minks(case, problem, solver, moves),
        ours(case, rmrc.Controller(problem, engine="python"), moves),
    )
    times = alternating(sides, WARM_UP, STEPS)
    # All must have done the same work, or the times say nothing.
    first, *others = (step(len(moves) - 1) for step in sides)
    apart = max(float(np.abs(first - other).max()) for other in others)
    if apart > 1e-3:
        raise SystemExit(f"{case.name}: the two paths are {apart:.1e} apart: not the same work")
    return {
        "case": case.name,
        "nv": problem.model.nv,
        "tasks": case.tasks,
        "engine": controller.engine.name,
        "mink_solver": solver,
        **figures(("rmrc", "mink", "python"), times),
    }


def main() -> None:
    """Run every case whose robot is at hand, and print a row for each."""
    arguments = parser(__doc__).parse_args()
    print(f"machine: {machine()}; dt {DT * 1e3:g} ms, {WARM_UP} + {STEPS} steps in runs of {RUN}")
    print(
        f"{'case':8} {'nv':>3} {'tasks':>5} {'rmrc µs':>9} {'p99':>8} {'mink µs':>9} {'p99':>8}"
        f" {'ratio':>6} {'engine':>7} {'in Python':>9}  mink's solver"
    )
    rows = []
    for case in CASES:
        try:
            row = measure(case)
        except rmrc.RmrcError as absent:
            print(f"{case.name:8} skipped: {absent}")
            continue
        rows.append(row)
        print(
            f"{row['case']:8} {row['nv']:3} {row['tasks']:5} {row['rmrc_median_us']:9.1f}"
            f" {row['rmrc_p99_us']:8.1f} {row['mink_median_us']:9.1f} {row['mink_p99_us']:8.1f}"
            f" {row['ratio']:6.3f} {row['engine']:>7} {row['python_median_us']:9.1f}"
            f"  {row['mink_solver']}"
        )
    write(arguments.json, "step", {"rows": rows})


if __name__ == "__main__":
    main()
