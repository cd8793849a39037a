# pyright: reportMissingImports=false
"""placo's side: its compiled kinematics solver.

What it does otherwise: a task has no gain, so that all sides go to their targets in one step; the
error of an orientation is the logarithm in the world without the logarithm's Jacobian; a step may
go all the way to a position limit; the base of the robot always floats, and an equality holds it
where it does not; and the regularization, its λ², leaves the base out.
"""

import numpy as np
import placo

from side import Side, Work, matrices, points

PACKAGES = ("placo", "pin")
"""Whose versions matter."""


def build(work: Work, _: str) -> Side:
    """Return the side for the work."""
    robot = placo.RobotWrapper(work["urdf"], placo.Flags.ignore_collisions)
    names, start = work["joints"], np.array(work["start"])
    if work["floating"]:
        base = np.eye(4)
        base[:3, 3] = start[:3]
        robot.set_T_world_fbase(base)
    posture = dict(zip(names, start[-len(names) :], strict=True))
    for name, value in posture.items():
        robot.set_joint(name, value)
    robot.update_kinematics()
    robot.set_velocity_limits(work["speed"])
    solver = placo.KinematicsSolver(robot)
    solver.dt = work["dt"]
    solver.mask_fbase(not work["floating"])
    solver.enable_joint_limits(True)
    solver.enable_velocity_limits(True)
    solver.add_regularization_task(work["damping"])
    joints = solver.add_joints_task()
    joints.set_joints(posture)
    joints.configure("posture", "soft", work["posture"])
    targets, frames = matrices(work), []
    for (_, name), pose in zip(work["frames"], targets[0], strict=True):
        frame = solver.add_frame_task(name, pose)
        frame.configure(name, "soft", 1.0, 1.0)
        frames.append(frame)
    poses, centres, com = [list(each) for each in targets], points(work), None
    if centres is not None:
        com = solver.add_com_task(centres[0])
        com.configure("com", "soft", 1.0)

    def step(k: int) -> None:
        for frame, pose in zip(frames, poses[k], strict=True):
            frame.T_world_frame = pose
        if com is not None and centres is not None:
            com.target_world = centres[k]
        solver.solve(True)
        robot.update_kinematics()

    def configuration() -> np.ndarray:
        q = robot.state.q
        moved = np.array([robot.get_joint(name) for name in names])
        return np.hstack([q[:3], q[6], q[3:6], moved]) if work["floating"] else moved

    return Side(step, configuration, "eiquadprog")
