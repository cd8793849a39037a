"""Targets on their paths: where each task should be at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.errors import ConfigError
from rmrc.paths import PathModel, Trajectory
from rmrc.problem.problem import Problem
from rmrc.tasks.base import Term
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]


@dataclass(eq=False)
class Aim:
    """One task's target on its path."""

    term: Term
    path: Trajectory
    pose: Array
    twist: Array

    def sample(self, now: float) -> None:
        """Look up where the target is at a time from the start, s."""
        self.path.sample(now, self.pose, self.twist)

    def set_on(self, controller: Controller, moving: bool = True) -> None:
        """Hand the target over, with its velocity or at rest."""
        twist = self.twist if moving and self.twist.any() else None
        if self.term.target_kind == "pose":
            controller.set_target(self.term.name, self.pose[:3], self.pose[3:], twist)
        else:
            velocity = None if twist is None else twist[:3]
            controller.set_target(self.term.name, self.pose[:3], velocity=velocity)


def build_aims(problem: Problem) -> list[Aim]:
    """Build the paths of all targets from where the targets are at the start.

    Raises:
        ConfigError: If a path does not exist from there.
    """
    starts = {}
    for name in problem.config.targets:
        term = problem.named(name)
        starts[name] = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        if term.target_kind == "pose":
            starts[name][:3], starts[name][3:] = term.target[4:], term.target[:4]
        else:
            starts[name][:3] = term.target
    paths = _built(problem, "targets", problem.config.targets, starts)
    return [Aim(problem.named(name), path, np.empty(7), np.empty(6)) for name, path in paths]


def _built(
    problem: Problem, key: str, models: Mapping[str, PathModel], starts: Mapping[str, Array]
) -> list[tuple[str, Trajectory]]:
    """Build the paths under one key of the configuration, each from its start pose."""
    paths, mistakes = [], []
    for name, model in models.items():
        try:
            paths.append((name, model.build(starts[name], problem.config.root)))
        except ConfigError as mistake:
            mistakes.append(Mistake((key, name), str(mistake)))
    if mistakes:
        raise config_error(mistakes, problem.config)
    return paths


@dataclass(eq=False)
class MovingObstacle:
    """One mocap body on its path."""

    body: str
    path: Trajectory
    pose: Array
    twist: Array

    def move(self, now: float, controller: Controller) -> None:
        """Set the body to where it is at a time from the start, s, with its velocity."""
        self.path.sample(now, self.pose, self.twist)
        controller.set_obstacle(self.body, self.pose[:3], self.pose[3:], self.twist)


def build_obstacles(problem: Problem) -> list[MovingObstacle]:
    """Build the paths of the mocap bodies from where the model has them.

    Raises:
        ConfigError: If a path does not exist from there.
    """
    model, moved = problem.model, problem.config.obstacles
    bodies = {name: model.body(name).id for name in moved}
    starts = {
        name: np.concatenate([model.body_pos[body], model.body_quat[body]])
        for name, body in bodies.items()
    }
    paths = _built(problem, "obstacles", moved, starts)
    return [MovingObstacle(name, path, np.empty(7), np.empty(6)) for name, path in paths]


def unfinished(aims: Sequence[Aim], config: Config) -> list[str]:
    """Return what there is to say about paths that are longer than the run."""
    late = [aim for aim in aims if aim.path.duration > config.duration + 0.5 * config.dt]
    return [
        f"the run of {config.duration:g} s ends before the path of '{aim.term.name}', "
        f"which takes {aim.path.duration:g} s"
        for aim in late
    ]
