"""How long a step takes on this machine, with each engine that is here."""

import platform
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.control.engines import missing
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.runs.target_paths import Aim, build_aims

WARM_UP, STEPS, TURN = 200, 2000, 50
"""Steps before those that count, the most that count, and those of an engine in its turn."""

JOINTS = 7
_LINK = (
    '<body pos="0 0 0.15"><joint name="joint{}" axis="{}" range="-2.8 2.8"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 0.15" size="0.04"/>'
)
_AXES = ("0 0 1", "0 1 0")
ARM = (
    '<mujoco model="arm"><compiler angle="radian" autolimits="true"/><worldbody>'
    + "".join(_LINK.format(k + 1, _AXES[k % 2]) for k in range(JOINTS))
    + '<site name="hand" pos="0 0 0.2"/>'
    + "</body>" * JOINTS
    + "</worldbody></mujoco>"
)
"""An arm of seven joints, for who has no configuration at hand."""


def bench(config: Config | None = None) -> dict[str, Any]:
    """Return the times of a configuration's steps by engine, as plain data.

    Only what a controller does is timed, its targets set and the step taken; the engines take
    turns. Joints are moved as commanded, whatever `follow` and `execute` say.

    Args:
        config: The configuration; by default an arm of seven joints whose hand moves on a circle.

    Raises:
        ConfigError: If the configuration does not fit its scene.
    """
    problem = _arm() if config is None else compile(config)
    automatic = Controller(problem)
    controllers = {c.engine.name: c for c in (automatic, Controller(problem, engine="python"))}
    aims = build_aims(problem)
    count = min(WARM_UP + STEPS, problem.config.steps)
    poses, twists = np.zeros((count, len(aims), 7)), np.zeros((count, len(aims), 6))
    for k in range(count):
        for aim, pose, twist in zip(aims, poses[k], twists[k], strict=True):
            aim.path.sample(k * problem.dt, pose, twist)
    times = {name: np.empty(count) for name in controllers}
    for begin in range(0, count, TURN):
        for name, controller in controllers.items():
            for k in range(begin, min(begin + TURN, count)):
                times[name][k] = _timed(controller, aims, poses[k], twists[k])
    counted, absent = min(WARM_UP, count // 2), missing()
    return {
        "dofs": len(problem.dofs),
        "tasks": len(problem.terms),
        "steps": count - counted,
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "native": absent is None,
        "notices": [f"the native engine is not there: {absent}"] if absent else automatic.notices,
        "engines": {name: _figures(taken[counted:]) for name, taken in times.items()},
    }


def _timed(
    controller: Controller, aims: Sequence[Aim], poses: np.ndarray, twists: np.ndarray
) -> float:
    """Set the targets, take a step, and return how long it took, µs."""
    for aim, pose, twist in zip(aims, poses, twists, strict=True):
        aim.pose[:], aim.twist[:] = pose, twist
    begin = time.perf_counter_ns()
    for aim in aims:
        aim.set_on(controller)
    controller.step()
    return (time.perf_counter_ns() - begin) / 1e3


def _figures(times: np.ndarray) -> dict[str, float]:
    median, p99 = np.percentile(times, (50, 99))
    return {"median_us": round(float(median), 1), "p99_us": round(float(p99), 1)}


def _arm() -> Problem:
    """Return the problem of the arm."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "arm.xml"
        scene.write_text(ARM)
        return compile(
            Config.model_validate(
                {
                    "scene": str(scene),
                    "start": {f"joint{k + 1}": 0.4 * (k % 2) for k in range(JOINTS)},
                    "duration": 5.0,
                    "tasks": [
                        {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
                        {"name": "posture", "type": "posture", "B": 0.01},
                    ],
                    "targets": {
                        "hand": {
                            "path": "circle",
                            "center": [0.0, 0.0, 0.8],
                            "normal": [0.0, 0.0, 1.0],
                            "speed": 0.1,
                        }
                    },
                }
            )
        )
