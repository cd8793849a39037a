"""The whole step beside mink's: set the targets, solve, integrate; short runs, alternating.

Where the targets will be is known before: what is timed is the work of the two, not of this file.

Both have the same robot, tasks, weights, limits and dt, in one process. mink runs with the fastest
of its backends that are installed. Prints median, p99 and the ratio of the medians, the
engine that `auto` takes and the median of the Python engine, and the
machine they are of; `--json FILE` writes them. `make bench` keeps BLAS to one thread: at this size
more threads only add noise.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import qpsolvers

import rmrc
from rmrc.control.engines import Choice
from rmrc.problem.limits.joints import HINGE_SPEED
from rmrc.problem.problem import Problem

REPOSITORY = Path(__file__).resolve().parent.parent
DT = 0.002
GAIN = 0.02  # mink's, per step; ours is GAIN / DT in 1/s
LAMBDA = 0.01
WARM_UP, STEPS, RUN = 500, 5000, 50
AMPLITUDE = 0.03  # m, of the targets' motion


@dataclass(frozen=True)
class Case:
    """A robot and its tasks."""

    name: str
    scene: str
    frames: tuple[tuple[str, str], ...]
    com: bool = False

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


def compile_case(case: Case) -> Problem:
    """Return the problem of a case."""
    gain = GAIN / DT
    tasks: list[dict[str, Any]] = [
        {"name": name, "type": "frame", "frame": {kind: name}, "gain": gain}
        for kind, name in case.frames
    ]
    if case.com:
        tasks.append({"name": "com", "type": "com", "gain": gain})
    tasks.append({"name": "posture", "type": "posture", "B": 1e-4, "gain": gain})
    return rmrc.compile(
        rmrc.Config.model_validate(
            {"scene": case.scene, "dt": DT, "damping": {"lambda": LAMBDA}, "tasks": tasks}
        )
    )


def ours(
    case: Case, problem: Problem, moves: np.ndarray, engine: Choice = "auto"
) -> Callable[[int], np.ndarray]:
    """Return step k of rmrc's, with its targets moved by moves[k]: configuration out."""
    controller = rmrc.Controller(problem, engine=engine)
    targets = [(name, problem.term[name].target) for _, name in case.frames]
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
    case: Case, problem: Problem, solver: str, moves: np.ndarray
) -> Callable[[int], np.ndarray]:
    """Return one step of mink's for the same work."""
    model = problem.model
    configuration = mink.Configuration(model, problem.start)
    frames = [mink.FrameTask(name, kind, 1.0, 1.0, gain=GAIN) for kind, name in case.frames]
    posture = mink.PostureTask(model, cost=1e-2, gain=GAIN)
    posture.set_target(problem.start)
    tasks: list[mink.Task] = [*frames, posture]
    still = np.zeros((len(moves), 4))
    poses = [
        [mink.SE3(pose) for pose in problem.term[name].target + np.hstack([still, moves])]
        for _, name in case.frames
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


def fastest_solver(case: Case, problem: Problem) -> str:
    """Return mink's fastest backend here for a case."""
    medians = {}
    for solver in ("daqp", "proxqp", "quadprog", "osqp"):
        if solver in qpsolvers.available_solvers:
            step = minks(case, problem, solver, offsets(300))
            medians[solver] = np.median([_timed(step, k) for k in range(300)][100:])
    return min(medians, key=lambda solver: medians[solver])


def _timed(step: Callable[[int], np.ndarray], k: int) -> float:
    begin = time.perf_counter_ns()
    step(k)
    return (time.perf_counter_ns() - begin) / 1e3


def measure(case: Case) -> dict[str, Any]:
    """Return both sides' times in µs over alternating steps."""
    problem = compile_case(case)
    solver = fastest_solver(case, problem)
    moves = offsets(WARM_UP + STEPS)
    sides = (
        ours(case, problem, moves),
        minks(case, problem, solver, moves),
        ours(case, problem, moves, "python"),
    )
    times = np.empty((WARM_UP + STEPS, len(sides)))
    for begin in range(0, WARM_UP + STEPS, RUN):
        for side, step in enumerate(sides):
            for k in range(begin, begin + RUN):
                times[k, side] = _timed(step, k)
    times = times[WARM_UP:]
    # All must have done the same work, or the times say nothing.
    first, *others = (step(len(moves) - 1) for step in sides)
    apart = max(float(np.abs(first - other).max()) for other in others)
    if apart > 1e-3:
        raise SystemExit(f"{case.name}: the two paths are {apart:.1e} apart: not the same work")
    medians, p99 = np.median(times, axis=0), np.percentile(times, 99, axis=0)
    return {
        "case": case.name,
        "nv": problem.model.nv,
        "tasks": case.tasks,
        "rmrc_median_us": round(float(medians[0]), 2),
        "rmrc_p99_us": round(float(p99[0]), 2),
        "mink_solver": solver,
        "mink_median_us": round(float(medians[1]), 2),
        "mink_p99_us": round(float(p99[1]), 2),
        "engine": rmrc.Controller(problem).engine.name,
        "python_median_us": round(float(medians[2]), 2),
        "ratio": round(float(medians[0] / medians[1]), 3),
    }


def machine() -> str:
    """Return the processor, the number of cores and the interpreter."""
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        processor = names[0].split(":")[1].strip() if names else processor
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}"


def main() -> None:
    """Run every case whose robot is at hand, and print a row for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures here too")
    arguments = parser.parse_args()
    beside = REPOSITORY.parent / "shared" / "menagerie"
    if beside.is_dir():
        os.environ.setdefault("MENAGERIE_ROOT", str(beside))
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
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": machine(), "step": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
