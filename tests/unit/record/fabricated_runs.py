"""Runs that were never run, of an arm and of a humanoid."""

from typing import Any

import numpy as np

from rmrc.record.run import Run
from rmrc.record.summary import summarize

STATUSES = [
    "OK",
    "LIMITED",
    "SCALED",
    "DAMPED",
    "RECOVERING",
    "RELAXED",
    "STUCK",
    "MAX_ITER",
    "DEADLINE",
    "STALE",
    "INVALID_INPUT",
]
TOLERANCE = {"m": 1e-3, "rad": 1e-2}


def hinge(name: str, address: int, dof: int, half_range: float | None = 2.8) -> dict[str, Any]:
    return {
        "name": name,
        "type": "hinge",
        "qpos": address,
        "dof": dof,
        "unit": "rad",
        "range": None if half_range is None else [-half_range, half_range],
        "velocity": 2.0,
    }


def arm_model() -> dict[str, Any]:
    """Seven hinges, the last without a range."""
    joints = [hinge(f"joint{i + 1}", i, i, None if i == 6 else 2.8 - 0.2 * i) for i in range(7)]
    return {"nq": 7, "nv": 7, "joints": joints}


def humanoid_model() -> dict[str, Any]:
    """A floating base and 37 hinges."""
    base = {"name": "pelvis", "type": "free", "qpos": 0, "dof": 0, "unit": "m", "range": None}
    names = [f"{side}_{part}_joint" for side in ("left", "right") for part in _PARTS]
    names += ["waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"]
    hinges = [hinge(name, 7 + i, 6 + i, 1.0 + 0.05 * i) for i, name in enumerate(names)]
    return {"nq": 44, "nv": 43, "joints": [base | {"velocity": [1.0, 1.0]}, *hinges]}


_PARTS = [
    *("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"),
    *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"),
    *("wrist_roll", "wrist_pitch", "wrist_yaw", "thumb_0", "thumb_1", "thumb_2", "index_0"),
]


def fabricated(
    model: dict[str, Any],
    steps: int = 200,
    dt: float = 0.002,
    name: str = "reach",
    tasks: dict[str, Any] | None = None,
) -> Run:
    """Return a run whose joints swing, whose errors decay, and which has every kind of row."""
    random = np.random.default_rng(0)
    tasks = tasks or {
        "hand": {"type": "frame", "units": ["m", "rad"]},
        "posture": {"type": "posture", "units": ["rad"]},
    }
    time = dt * np.arange(steps, dtype=np.float64)
    v = 1.8 * np.sin(
        2.0 * time[:, None] * random.uniform(0.3, 2.0, model["nv"])
        + random.uniform(0, 6, model["nv"])
    )
    q = np.zeros((steps, model["nq"]))
    for joint in model["joints"]:
        width = 6 if joint["type"] == "free" else 1
        at, dof = joint["qpos"], joint["dof"]
        q[:, at : at + width] = dt * np.cumsum(v[:, dof : dof + width], axis=0)
        if joint["type"] == "free":
            q[:, at + 3 : at + 7] = [1, 0, 0, 0]
        elif joint["range"]:
            q[:, at] = np.clip(q[:, at], *joint["range"])
    decay = np.exp(-3.0 * time)[:, None] + 1e-5
    error = {
        task: np.array([0.4, 0.8, 0.2][: len(what["units"])]) * decay
        for task, what in tasks.items()
    }
    active = np.where(v > 1.75, 1, np.where(v < -1.79, -1, 0)).astype(np.int8)
    status = np.where(active.any(axis=1), 1, 0).astype(np.uint8)
    status[steps // 2 : steps // 2 + steps // 50] = STATUSES.index("RELAXED")
    step_time = random.lognormal(np.log(60e-6), 0.25, steps)
    config = {
        "scene": "../scenes/arm.xml",
        "dt": dt,
        "duration": steps * dt,
        "tolerance": {"position": 1e-3, "orientation": 1e-2},
        "tasks": [{"name": task, "type": what["type"]} for task, what in tasks.items()],
    }
    summary = summarize(
        dt=dt,
        q=q,
        v=v,
        status=status,
        error=error,
        step_time=step_time,
        model=model,
        tasks=tasks,
        statuses=STATUSES,
        engine="python",
        backend="daqp",
        method="qp",
        tolerance=TOLERANCE,
        converging={next(iter(tasks)): (0,)},
        least={},
        resolution=1e-6,
    )
    manifest = {
        "name": name,
        "config": config,
        "config_hash": "0123abcd",
        "root": "configs",
        "versions": {"rmrc": "0.1.0", "mujoco": "4.0.0"},
        "seed": 0,
        "statuses": STATUSES,
        "model": model,
        "tasks": tasks,
        "summary": summary,
    }
    return Run(
        time=time,
        q=q,
        v=v,
        v_measured=v,
        status=status,
        error=error,
        sigma_min=0.1 + 0.09 * np.cos(2 * time),
        active=active,
        kkt=10.0 ** random.uniform(-15, -11, steps),
        step_time=step_time,
        manifest=manifest,
    )
