"""The three ways of following a path: resolved rates, every pose solved, joints interpolated."""

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.control.controller import Controller
from rmrc.control.step import Step
from rmrc.model.carrier import carry_on
from rmrc.paths.base import PathModel, TimedPath
from rmrc.paths.profiles import PROFILES
from rmrc.problem.problem import Problem
from rmrc.reaching.converge import Reacher
from rmrc.runs.target_paths import Aim
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]


class Follower(Protocol):
    """Turns the targets of a moment into a step."""

    solves: int
    """How often the method has been solved so far."""

    def step(self, now: float, q: Array | None) -> Step:
        """Return the step at a time from the start, s, from q (nq,) or the last step's end."""
        ...


class RateFollower:
    """`rate`: one solve a step, on the rate that the path and the error ask for."""

    def __init__(self, controller: Controller, aims: Sequence[Aim]):
        self._controller, self._aims, self.solves = controller, aims, 0

    def step(self, now: float, q: Array | None) -> Step:
        """Hand the targets over and solve."""
        for aim in self._aims:
            aim.set_on(self._controller)
        self.solves += 1
        return self._controller.step(q)


class WaypointFollower:
    """`waypoints`: the pose that the path has one step later is solved to convergence."""

    def __init__(self, controller: Controller, aims: Sequence[Aim]):
        self._controller, self._aims, self.solves = controller, aims, 0
        self._reacher = Reacher(controller.problem)
        self._set_points = _SetPoints(controller)

    def step(self, now: float, q: Array | None) -> Step:
        """Solve the next pose and command the difference."""
        for aim in self._aims:
            aim.set_on(self._controller, moving=False)
        for aim in self._aims:
            aim.sample(now + self._controller.problem.dt)
            aim.set_on(self._reacher.controller, moving=False)
        self._set_points.see(q)
        here, ahead = self._controller.engine.evaluation, self._reacher.controller.engine.evaluation
        carry_on(ahead.data, here.data, here.obstacle_twist, self._controller.problem.dt)
        reached = self._reacher.solve(self._set_points.q)
        self.solves += reached.iterations
        return self._set_points.move_to(reached.q, q)


def joint_timing(problem: Problem, aims: Sequence[Aim]) -> TimedPath:
    """Return the timed path whose profile, delay and duration all joints take over.

    Raises:
        ConfigError: If there is none, or targets that move in another time.
    """
    models = problem.config.targets
    timed = [(aim, path) for aim in aims if isinstance(path := models[aim.term.name], TimedPath)]
    if not timed:
        raise config_error(
            [Mistake(("follow",), "joint needs a target on a path with a duration or a speed")],
            problem.config,
        )
    first, path = timed[0]
    others = {
        aim.term.name: _timing(aim, models[aim.term.name])
        for aim in aims
        if aim.path.duration > 0.0
    }
    own = others[first.term.name] if first.path.duration > 0.0 else _timing(first, path)
    for name, other in others.items():
        if other != own:
            raise config_error(
                [
                    Mistake(
                        ("follow",),
                        f"joint moves all joints in one time, and '{first.term.name}' takes {own} "
                        f"where '{name}' takes {other}: give them the same, or take rate or "
                        "waypoints",
                    )
                ],
                problem.config,
            )
    return path


def _timing(aim: Aim, path: PathModel) -> str:
    """Return the time that a target takes, as a message says it."""
    if not isinstance(path, TimedPath):
        return f"times of its own, up to {aim.path.duration:g} s"
    taken = aim.path.duration - path.delay
    return f"{taken:g} s with the profile {path.profile} after a delay of {path.delay:g} s"


class JointFollower:
    """`joint`: the poses at both ends are solved, and the joints go from one to the other.

    q(t) = q₀ ⊕ s(t) (q₁ ⊖ q₀), with the profile s of the path.
    """

    def __init__(self, controller: Controller, aims: Sequence[Aim]):
        self._controller, self._aims = controller, aims
        path = joint_timing(controller.problem, aims)
        self._profile = PROFILES[path.profile]
        self._delay = path.delay
        last = max(aim.path.duration for aim in aims)
        self._duration = last - path.delay
        reacher = Reacher(controller.problem)
        ends = []
        self.solves, q = 0, controller.problem.start
        for end in (0.0, last):
            for aim in aims:
                aim.sample(end)
                aim.set_on(reacher.controller, moving=False)
            reached = reacher.solve(q)
            q = reached.q
            self.solves += reached.iterations
            ends.append(q)
        self._begin = ends[0]
        self._tangent = _difference(controller, ends[0], ends[1], 1.0)
        self._set_points = _SetPoints(controller)

    def step(self, now: float, q: Array | None) -> Step:
        """Command the difference to where the joints should be one step later."""
        for aim in self._aims:
            aim.set_on(self._controller, moving=False)
        controller = self._controller
        later = (now + controller.problem.dt - self._delay) / self._duration
        share, _ = self._profile.at(min(max(later, 0.0), 1.0))
        wanted = self._begin.copy()
        mujoco.mj_integratePos(controller.problem.model, wanted, self._tangent, share)
        return self._set_points.move_to(wanted, q)


FOLLOWERS = {"rate": RateFollower, "waypoints": WaypointFollower, "joint": JointFollower}
"""The class of each way of following."""


class _SetPoints:
    """Configurations commanded one after another, whatever is measured, as drives expect them."""

    def __init__(self, controller: Controller):
        self._controller = controller
        self.q = controller.problem.start.copy()
        """The last set point (nq,)."""

    def see(self, measured: Array | None) -> None:
        """Take over where objects are; they are no set points."""
        if measured is not None:
            objects = self._controller.problem.objects.coordinates
            self.q[objects] = measured[objects]

    def move_to(self, wanted: Array, measured: Array | None) -> Step:
        """Command the difference from the last set point, inside the box."""
        controller = self._controller
        step = controller.command(_difference(controller, self.q, wanted), measured)
        mujoco.mj_integratePos(controller.problem.model, self.q, step.v, controller.problem.dt)
        return step


def _difference(controller: Controller, a: Array, b: Array, dt: float | None = None) -> Array:
    """Return the velocity (nv,) that leads from a to b in dt seconds, by default one step."""
    v = np.empty(controller.problem.model.nv)
    seconds = controller.problem.dt if dt is None else dt
    mujoco.mj_differentiatePos(controller.problem.model, v, seconds, a, b)
    return v
