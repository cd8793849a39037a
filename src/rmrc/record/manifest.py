"""The manifest of a run: what was run, by which versions, and the model's joints and limits."""

import hashlib
import json
import platform
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np

from rmrc.limits.joints import held_ranges
from rmrc.model.configuration import joint_dofs, joint_type
from rmrc.problem.problem import Problem

PACKAGES = ("rmrc", "mujoco", "mink", "numpy", "daqp", "proxsuite", "osqp", "qpsolvers")

_TYPES = {
    mujoco.mjtJoint.mjJNT_FREE: ("free", None),
    mujoco.mjtJoint.mjJNT_BALL: ("ball", "rad"),
    mujoco.mjtJoint.mjJNT_SLIDE: ("slide", "m"),
    mujoco.mjtJoint.mjJNT_HINGE: ("hinge", "rad"),
}


def manifest(problem: Problem, statuses: list[str]) -> dict[str, Any]:
    """Return everything of a run's manifest but its summary.

    Its joints are those of the robot; of the objects the names are there.
    """
    config = problem.config.resolved()
    text = json.dumps(config, sort_keys=True)
    return {
        "name": problem.config.name,
        "config": config,
        "config_hash": hashlib.sha256(text.encode()).hexdigest(),
        "root": str(problem.config.root),
        "versions": {"python": platform.python_version()}
        | {package: version(package) for package in PACKAGES},
        "seed": problem.config.actuation.seed,
        "statuses": statuses,
        "notices": list(problem.notices),
        "model": _model(problem),
        "tasks": {
            term.name: {"type": term.type, "units": list(term.units)}
            for term in problem.terms
            if term.units
        },
    }


def _model(problem: Problem) -> dict[str, Any]:
    model = problem.model
    box = problem.box
    rates = np.full((3, model.nv), np.inf)
    rates[:, problem.dofs] = box.velocity, box.acceleration, box.jerk
    ranges = held_ranges(model, problem.config.limits)
    joints = []
    for joint in problem.objects.robot_joints():
        kind, unit = _TYPES[joint_type(model, joint)]
        first = joint_dofs(model, joint)[0]
        velocity, acceleration, jerk = (_finite(float(rate)) for rate in rates[:, first])
        turning = _finite(float(rates[0, first + 3])) if kind == "free" else None
        joints.append(
            {
                "name": model.joint(joint).name or f"joint {joint}",
                "type": kind,
                "qpos": int(model.jnt_qposadr[joint]),
                "dof": int(first),
                "unit": unit,
                "range": ranges[joint].tolist() if np.isfinite(ranges[joint]).all() else None,
                "velocity": [velocity, turning] if kind == "free" else velocity,
                "acceleration": acceleration,
                "jerk": jerk,
            }
        )
    return {
        "nq": model.nq,
        "nv": model.nv,
        "mocap": 7 * model.nmocap,
        "joints": joints,
        "objects": [problem.objects.name(root) for root in problem.objects.roots],
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
