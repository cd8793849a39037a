"""The robots and tasks of the benchmarks, and what is handed to the sides of one."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import rmrc
from peers.descriptions import ROBOT, write_robot
from rmrc.limits.collision import CollisionPairs
from rmrc.limits.joints import HINGE_SPEED
from rmrc.problem.problem import Problem
from timing import REPOSITORY

DT = 0.002
LAMBDA = 0.01
POSTURE = 1e-4
"""B of the posture task; of all others it is 1."""
POSITION_GAIN = 0.95
"""Share of the way to a position limit that one step may go: the default of rmrc and of mink."""
AMPLITUDE = 0.03  # m, of the targets' motion


@dataclass(frozen=True)
class Case:
    """A robot and its tasks."""

    name: str
    scene: str
    """A scene of rmrc's, or the name of a robot that MuJoCo and Pinocchio read from one URDF."""
    frames: tuple[tuple[str, str], ...]
    com: bool = False
    gain: float = 1.0
    """Share of the error that a step takes away: placo's is 1."""
    others: dict[str, Any] = field(default_factory=dict)
    """Other parts of the configuration."""

    @property
    def names(self) -> list[str]:
        """Names of the tasks on the frames."""
        return [name.replace("/", "_") for _, name in self.frames]

    @property
    def tasks(self) -> int:
        """Number of tasks, the posture included."""
        return len(self.frames) + self.com + 1

    def config(self, scene: str) -> dict[str, Any]:
        """Return the configuration, as plain data."""
        gain = self.gain / DT
        tasks: list[dict[str, Any]] = [
            {"name": name, "type": "frame", "frame": {kind: frame}, "gain": gain}
            for (kind, frame), name in zip(self.frames, self.names, strict=True)
        ]
        if self.com:
            tasks.append({"name": "com", "type": "com", "gain": gain})
        tasks.append({"name": "posture", "type": "posture", "B": POSTURE, "gain": gain})
        return {"scene": scene, "dt": DT, "damping": {"lambda": LAMBDA}, "tasks": tasks} | (
            self.others
        )


PANDA = Case("panda", str(REPOSITORY / "scenes" / "panda.xml"), (("site", "hand"),))
G1 = Case(
    "g1",
    "menagerie:unitree_g1/g1",
    (
        ("site", "left_foot"),
        ("site", "right_foot"),
        ("site", "left_palm"),
        ("site", "right_palm"),
        ("body", "torso_link"),
    ),
    com=True,
)
ALOHA = Case(
    "aloha",
    "menagerie:aloha/scene",
    (("site", "left/gripper"), ("site", "right/gripper")),
    others={"start": "neutral_pose"},  # without it the arms start inside each other
)
COLLISION = {"collision": {"pairs": "all", "gain": 0.85}}
"""With mink's own gain, and our distances: with its own, 5 and 10 mm, no pair would be near."""


def offsets(steps: int) -> np.ndarray:
    """Return how far the targets are displaced at each step: a slow figure, the same for all."""
    phase = 2 * np.pi * np.arange(steps) * DT / 4.0
    return AMPLITUDE * np.stack([np.sin(phase), np.sin(2 * phase), np.cos(phase) - 1], axis=1)


def prepare(case: Case, folder: Path, steps: int) -> tuple[Problem, Path]:
    """Return the problem of a case, and the file that tells every side what to do.

    Raises:
        RmrcError, FileNotFoundError: If the robot is not at hand.
    """
    scene, urdf = case.scene, None
    if scene in ROBOT:
        mjcf, urdf = write_robot(scene, folder)
        scene = str(mjcf)
    config = case.config(scene)
    problem = rmrc.compile(rmrc.Config.model_validate(config))
    model, compiled = problem.model, folder / f"{case.name}.mjb"
    mujoco.mj_saveModel(model, str(compiled))
    free = {mujoco.mjtJoint.mjJNT_FREE}
    work = {
        "config": config,
        "model": str(compiled),
        "urdf": str(urdf) if urdf else None,
        "floating": bool(free & set(model.jnt_type)),
        "dt": DT,
        "damping": LAMBDA**2,
        "posture": POSTURE,
        "gain": case.gain,
        "position_gain": POSITION_GAIN,
        "speed": HINGE_SPEED,
        "frames": case.frames,
        "names": case.names,
        "joints": [
            model.joint(j).name
            for j in range(model.njnt)
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        ],
        "start": problem.start.tolist(),
        "poses": [problem.term[name].target.tolist() for name in case.names],
        "point": problem.term["com"].target.tolist() if case.com else None,
        "moves": offsets(steps).tolist(),
        "collision": collision(problem),
    }
    path = folder / f"{case.name}.json"
    path.write_text(json.dumps(work))
    return problem, path


def collision(problem: Problem) -> dict[str, Any] | None:
    """Return the pairs of geoms that are kept apart and how, in mink's words."""
    for limit in problem.barriers:
        if isinstance(limit, CollisionPairs):
            return {
                "geom_pairs": [([a], [b]) for a, b in limit.geoms.tolist()],
                "gain": limit.gain,
                "minimum_distance_from_collisions": limit.d_min,
                "collision_detection_distance": limit.detect,
            }
    return None
