"""The whole step beside mink's: set the targets, solve, integrate; short runs, alternating.

Both have the same robot, tasks, weights, limits and dt, in one process. mink runs with the fastest
of its backends that are installed. Prints median, p99 and the ratio of the medians, and the
machine they are of; `--json FILE` writes them. `make bench` keeps BLAS to one thread: at this size
more threads only add noise.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import qpsolvers

import rmrc
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


def ours(
    case: Case, problem: Problem, controller: rmrc.Controller | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """Return one step of rmrc's: targets moved by an offset in, configuration out."""
    controller = controller or rmrc.Controller(problem)
    targets = [problem.term[name].target for name in case.names]
    poses = [(target[4:].copy(), target[:4].copy()) for target in targets]
    com = problem.term["com"].target.copy() if case.com else None

    def step(offset: np.ndarray) -> np.ndarray:
        for name, (position, quaternion) in zip(case.names, poses, strict=True):
            controller.set_target(name, position + offset, quaternion)
        if com is not None:
            controller.set_target("com", com + offset)
        return controller.step().q

    return step


def minks(
    case: Case, problem: Problem, solver: str, more: Sequence[mink.Limit] = ()
) -> Callable[[np.ndarray], np.ndarray]:
    """Return one step of mink's for the same work, with more limits if there are any."""
    model = problem.model
    configuration = mink.Configuration(model, problem.start)
    frames = [mink.FrameTask(name, kind, 1.0, 1.0, gain=GAIN) for kind, name in case.frames]
    posture = mink.PostureTask(model, cost=1e-2, gain=GAIN)
    posture.set_target(problem.start)
    tasks: list[mink.Task] = [*frames, posture]
    targets = [problem.term[name].target.copy() for name in case.names]
    com = mink.ComTask(1.0, gain=GAIN)
    com_target = problem.term["com"].target.copy() if case.com else np.zeros(3)
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

    def step(offset: np.ndarray) -> np.ndarray:
        for task, target in zip(frames, targets, strict=True):
            moved = target.copy()
            moved[4:] += offset
            task.set_target(mink.SE3(moved))
        if case.com:
            com.set_target(com_target + offset)
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
    medians = {}
    for solver in ("daqp", "proxqp", "quadprog", "osqp"):
        if solver in qpsolvers.available_solvers:
            step = minks(case, problem, solver, more)
            medians[solver] = np.median([_timed(step, offset) for offset in offsets(300)][100:])
    return min(medians, key=lambda solver: medians[solver])


def _timed(step: Callable[[np.ndarray], np.ndarray], offset: np.ndarray) -> float:
    begin = time.perf_counter_ns()
    step(offset)
    return (time.perf_counter_ns() - begin) / 1e3


def measure(case: Case) -> dict[str, Any]:
    """Return both sides' times in µs over alternating steps."""
    problem = compile_case(case)
    solver = fastest_solver(case, problem)
    rmrc_step, mink_step = ours(case, problem), minks(case, problem, solver)
    times = alternating((rmrc_step, mink_step), WARM_UP, STEPS)
    # The two must have done the same work, or the times say nothing.
    final = offsets(WARM_UP + STEPS)[-1]
    apart = float(np.abs(rmrc_step(final) - mink_step(final)).max())
    if apart > 1e-3:
        raise SystemExit(f"{case.name}: the two paths are {apart:.1e} apart: not the same work")
    return {
        "case": case.name,
        "nv": problem.model.nv,
        "tasks": case.tasks,
        "mink_solver": solver,
        **figures(times),
    }


def alternating(
    steps: Sequence[Callable[[np.ndarray], np.ndarray]], warm_up: int, count: int
) -> np.ndarray:
    """Return the times (count, sides) in µs of steps that take turns in short runs."""
    times, moves = np.empty((warm_up + count, len(steps))), offsets(warm_up + count)
    for begin in range(0, warm_up + count, RUN):
        for side, step in enumerate(steps):
            for k in range(begin, begin + RUN):
                times[k, side] = _timed(step, moves[k])
    return times[warm_up:]


def figures(times: np.ndarray) -> dict[str, float]:
    """Return median and p99 of both sides, ours first, and the ratio of the medians."""
    medians, p99 = np.median(times, axis=0), np.percentile(times, 99, axis=0)
    return {
        "rmrc_median_us": round(float(medians[0]), 2),
        "rmrc_p99_us": round(float(p99[0]), 2),
        "mink_median_us": round(float(medians[1]), 2),
        "mink_p99_us": round(float(p99[1]), 2),
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
    print(f"{'case':8} {'nv':>3} {'tasks':>5} {'rmrc µs':>9} {'p99':>8}"
          f" {'mink µs':>9} {'p99':>8} {'ratio':>6}  mink's solver")  # fmt: skip
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
            f" {row['ratio']:6.2f}  {row['mink_solver']}"
        )
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": machine(), "step": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
