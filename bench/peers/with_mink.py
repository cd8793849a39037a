"""mink's side, with the fastest of its backends for the work."""

from typing import Any

import mink
import mujoco
import numpy as np
import qpsolvers

from side import Side, Work, fastest, points

PACKAGES = ("mink", "mujoco")
"""Whose versions matter."""


def build(work: Work, solver: str) -> Side:
    """Return the side for the work; no solver asked for is the fastest."""
    if not solver:
        return fastest(lambda solver: build(work, solver), qpsolvers.available_solvers)
    model = mujoco.MjModel.from_binary_path(work["model"])
    configuration, dt = mink.Configuration(model, np.array(work["start"])), work["dt"]
    frames = [
        mink.FrameTask(name, kind, 1.0, 1.0, gain=work["gain"]) for kind, name in work["frames"]
    ]
    posture = mink.PostureTask(model, cost=work["posture"] ** 0.5, gain=work["gain"])
    posture.set_target(np.array(work["start"]))
    tasks: list[mink.Task] = [*frames, posture]
    moves = np.array(work["moves"])
    poses = [
        [mink.SE3(np.hstack([pose[:4], move + pose[4:]])) for move in moves]
        for pose in work["poses"]
    ]
    centres = points(work)
    com = mink.ComTask(1.0, gain=work["gain"])
    if centres is not None:
        tasks.append(com)
    speeds: dict[str, Any] = dict.fromkeys(work["joints"], work["speed"])
    limits: list[Any] = [
        mink.ConfigurationLimit(model, gain=work["position_gain"]),
        mink.VelocityLimit(model, speeds),
    ]
    if work["collision"]:
        limits.append(mink.CollisionAvoidanceLimit(model, **work["collision"]))

    def step(k: int) -> None:
        for task, targets in zip(frames, poses, strict=True):
            task.set_target(targets[k])
        if centres is not None:
            com.set_target(centres[k])
        v = mink.solve_ik(configuration, tasks, dt, solver, work["damping"], limits=limits)
        configuration.integrate_inplace(v, dt)

    return Side(step, lambda: configuration.q, solver)
