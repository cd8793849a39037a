# pyright: reportMissingImports=false
"""pink's side, with the fastest of its backends for the work."""

import numpy as np
import pink
import pinocchio
import qpsolvers
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import ComTask, FrameTask, PostureTask

from side import Side, Work, fastest, matrices, points

PACKAGES = ("pin-pink", "pin")
"""Whose versions matter."""


def build(work: Work, solver: str) -> Side:
    """Return the side for the work; no solver asked for is the fastest."""
    if not solver:
        return fastest(lambda solver: build(work, solver), qpsolvers.available_solvers)
    base = (pinocchio.JointModelFreeFlyer(),) if work["floating"] else ()
    model = pinocchio.buildModelFromUrdf(work["urdf"], *base)
    model.velocityLimit[6 if base else 0 :] = work["speed"]
    joints = [model.joints[model.getJointId(name)].idx_q for name in work["joints"]]
    # Where each element of MuJoCo's q is in Pinocchio's, which has quaternions as xyzw.
    order = np.array([0, 1, 2, 6, 3, 4, 5, *joints] if base else joints)
    start = np.empty(model.nq)
    start[order] = work["start"]
    configuration = pink.Configuration(model, model.createData(), start)
    gain, dt = work["gain"], work["dt"]
    frames = [FrameTask(name, 1.0, 1.0, gain=gain) for _, name in work["frames"]]
    posture = PostureTask(cost=work["posture"] ** 0.5, gain=gain)
    posture.set_target(start)
    tasks = [*frames, posture]
    poses = [[pinocchio.SE3(pose) for pose in each] for each in matrices(work).swapaxes(0, 1)]
    centres, com = points(work), ComTask(1.0, gain=gain)
    if centres is not None:
        tasks.append(com)
    limits = [ConfigurationLimit(model, work["position_gain"]), VelocityLimit(model)]

    def step(k: int) -> None:
        for task, targets in zip(frames, poses, strict=True):
            task.set_target(targets[k])
        if centres is not None:
            com.set_target(centres[k])
        v = pink.solve_ik(
            configuration, tasks, dt, solver, damping=work["damping"], limits=limits,
            safety_break=False,
        )  # fmt: skip
        configuration.integrate_inplace(v, dt)

    return Side(step, lambda: configuration.q[order], solver)
