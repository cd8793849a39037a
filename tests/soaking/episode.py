"""A random walk of a controller: targets, pushes, limits that change, and bad inputs."""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any
from zlib import crc32

import numpy as np

import rmrc
from models import random_configuration, random_quaternion
from rmrc.control.step import Status, Step
from rmrc.problem.frames import names
from rmrc.problem.problem import Problem
from rmrc.problem.tasks.base import Term
from soaking.checks import TOLERANCE, Array, Checker, Moment, carried
from soaking.scenes import OBSTACLE, Drawer, Generator, Scene, draw, scene_file

NAN, INF = float("nan"), float("inf")
FAR = 1e6
"""How many times as far away a target is that has gone astray."""
JUMPS = (1e-9, 1e-6, 0.1, 1.0)
"""Lengths in s of the step that comes now and then from a clock that has stood still or jumped."""
ASTRAY = 1e11
"""Largest number in a state from which the robot goes on; beyond it, it starts anew at rest."""
LATE = 1e-9
"""Rounding of a sum of times, s."""


class Violation(AssertionError):
    """A step that broke a promise, and how to run it again."""


@dataclass
class Figures:
    """What came of all steps."""

    statuses: Counter[str] = field(default_factory=Counter)
    """Steps by their most severe status."""
    worst: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TOLERANCE, 0.0))
    """The largest violation of each kind."""
    kkt: float = 0.0
    """The largest residual of a solution that nothing was reported of."""
    slowest: tuple[float, str] = (0.0, "")
    """The longest time of a step, s, and how to take it again."""
    braking: int = 0
    """Steps that braked for what came in."""
    steps: int = 0

    def add(self, step: Step, found: dict[str, float], braking: bool) -> None:
        """Take note of a step."""
        self.steps += 1
        self.statuses[step.status.name] += 1
        self.braking += braking
        for kind, excess in found.items():
            self.worst[kind] = max(self.worst[kind], excess)


def _spoilt(array: Array, rng: Generator) -> Array:
    spoilt = array.copy()
    spoilt[rng.integers(array.size)] = (NAN, INF, -INF, 1e300)[rng.integers(4)]
    return spoilt


class Episode:
    """Steps of one random configuration of a scene; the same seed gives the same ones."""

    def __init__(self, scene: Scene, seed: int, folder: Path):
        self.scene, self.seed = scene, seed
        self.rng = np.random.default_rng([crc32(scene.name.encode()), seed])
        self.drawer = Drawer(self.rng)
        self.config = draw(scene, scene_file(scene, folder), self.rng)
        self._problem = rmrc.compile(rmrc.Config.model_validate(self.config))
        self._jitter = self.drawer.chance(0.4)
        self._measured = self.drawer.chance(0.5)
        self._noise = self.drawer.among(0.0, 0.0, 1e-6, 1e-3)
        self._rough = self.drawer.among(0.0, 1.0, 1.0, 3.0)
        """How often something happens, beside what is usual."""
        model = self._problem.model
        self._twist = np.zeros((model.nmocap, 6))
        self._mocap = (
            int(model.body(OBSTACLE).mocapid[0]) if OBSTACLE in names(model, "mocap body") else -1
        )
        self._v, self._a = np.zeros((2, model.nv))
        self._number = 0
        self._go_on(self._problem, self._start())

    def _start(self) -> Array:
        """Return the start, or a configuration with many joints near the ends of their range."""
        box, q = self._problem.box, self._problem.start.copy()
        ranged = np.flatnonzero(np.isfinite(box.upper - box.lower))
        if self.drawer.chance(0.5):
            share = self.rng.beta(0.3, 0.3, ranged.size)
            between = (1.0 - share) * box.lower[ranged] + share * box.upper[ranged]
            q[box.coordinate[ranged]] = between
        return q

    def _go_on(self, problem: Problem, q: Array) -> None:
        """Have another problem from now on, at a configuration and with the present velocity."""
        self._problem = problem
        self._controller = rmrc.Controller(problem)
        self._controller.reset(q, self._v, self._a)
        self._checker = Checker(problem)
        self._ages: dict[str, float] = {}
        self._now = self._measured_at = 0.0
        self._twist[:] = 0.0

    def run(self, count: int, figures: Figures) -> Iterator[int]:
        """Take some steps; yield the number of those done.

        Raises:
            Violation: If a step breaks a promise.
        """
        for k in range(count):
            self._number = k
            try:
                moment, step = self._step(figures)
                found = self._checker.check(moment, step, self._controller)
            except Violation:
                raise
            except Exception as raised:
                raise Violation(self._message(k, f"raised {raised!r}")) from raised
            self._advance(moment, step)
            figures.add(step, found, moment.braking)
            wrong = {kind: x for kind, x in found.items() if not x <= TOLERANCE[kind]}
            if wrong:
                said = ", ".join(f"{kind} by {excess:.3g}" for kind, excess in wrong.items())
                raise Violation(self._message(k, f"{said} ({step.status.name})"))
            if not moment.braking and not step.flag_bits >> Status.MAX_ITER & 1:
                figures.kkt = max(figures.kkt, found["certificate"])
            yield k + 1

    def _message(self, k: int, said: str) -> str:
        return f"{said} at step {k}; again: {self._again(k)}\n  {json.dumps(self.config)}"

    def _again(self, k: int) -> str:
        return f"bench/soak.py --scene {self.scene.name} --seed {self.seed} --steps {k + 1}"

    def _advance(self, moment: Moment, step: Step) -> None:
        """Go where the command leads."""
        self._now += moment.dt
        self._v, self._a = step.v.copy(), (step.v - moment.v) / moment.dt
        if max(np.abs(step.q).max(), np.abs(self._v).max(), np.abs(self._a).max()) > ASTRAY:
            self._v[:], self._a[:] = 0.0, 0.0  # without limits and damping it may get anywhere
            self._go_on(self._problem, self._problem.start)
            return
        if self._twist.any():
            k, data = self._mocap, self._controller.engine.evaluation.data
            position, quaternion = carried(data, self._twist, moment.dt)
            self._controller.set_obstacle(OBSTACLE, position[k], quaternion[k], self._twist[k])

    def _often(self, share: float) -> bool:
        return self.drawer.chance(share * self._rough)

    def _step(self, figures: Figures) -> tuple[Moment, Step]:
        """Let something happen, and take a step."""
        if self._often(0.004):
            self._change_limits()
        if self._mocap >= 0 and self._often(0.01):
            self._move_obstacle()
        refused = False
        renewed = self._is_late() and self.drawer.chance(0.3)
        for term in self._problem.terms:
            if term.target.size and (renewed or self._often(0.03)):
                refused |= not self._set_target(term)
        if self._often(0.01):
            refused |= self._refused_target()
        arguments, moment = self._inputs()
        moment.invalid |= refused
        begin = perf_counter()
        step = self._controller.step(**arguments)
        figures.slowest = max(figures.slowest, (perf_counter() - begin, self._again(self._number)))
        return moment, step

    def _inputs(self) -> tuple[dict[str, Any], Moment]:
        """Return the arguments of a step, and what it starts from."""
        problem, rng, drawer = self._problem, self.rng, self.drawer
        arguments: dict[str, Any] = {}
        dt = problem.dt
        if self._jitter:
            dt = arguments["dt"] = problem.dt * rng.uniform(0.5, 1.5)
        if self._often(0.001):
            dt = arguments["dt"] = drawer.among(*JUMPS)
        q = self._controller.q
        pushed = self._often(0.01)
        if pushed:
            q = self._pushed(q)
        elif self._noise:
            q = random_configuration(problem.model, q, rng, self._noise)
        if (pushed or self._measured) and drawer.chance(0.98):
            arguments["q"] = q
            if pushed or self._noise:
                self._checker.disturb()
        else:  # the measurement is missing
            q = self._controller.q
        v, a = self._v, self._a
        if problem.config.previous == "measured":
            v = arguments["v"] = v + rng.normal(size=v.size) * drawer.among(0.0, 1e-3, 0.1)
            self._checker.disturb()
        moment = Moment(q, v, a, dt, self._twist, braking=False, invalid=False)
        self._spoil(arguments, moment)
        if self._stale(arguments, moment):
            moment.braking = True
        if moment.braking:
            moment.q, moment.v = self._controller.q, self._v
        return arguments, moment

    def _stale(self, arguments: dict[str, Any], moment: Moment) -> bool:
        """Return whether a step has to say that something is too old; perhaps make it so."""
        problem, drawer = self._problem, self.drawer
        if moment.braking:
            return False
        if "q" in arguments:
            if self._often(0.005):
                arguments["age"] = drawer.among(0.5, 3.0, 30.0) * problem.dt
            self._measured_at = self._now - arguments.get("age", 0.0)
        unseen = self._now - self._measured_at
        return self._is_late() or unseen > problem.measurement_timeout + LATE

    def _is_late(self) -> bool:
        """Return whether a target that was set is too old."""
        oldest = min(self._ages.values(), default=self._now)
        return self._now - oldest > self._problem.target_timeout + LATE

    def _spoil(self, arguments: dict[str, Any], moment: Moment) -> None:
        """Perhaps put something in that no step can use."""
        if not self._often(0.01):
            return
        rng, problem = self.rng, self._problem
        moment.braking = moment.invalid = True
        kind = rng.integers(4 if problem.config.previous == "measured" else 3)
        if kind == 0:
            arguments["dt"] = self.drawer.among(0.0, -1e-3, NAN, INF, 1e-12, 1e9, "soon")
            moment.dt = problem.dt
        elif kind == 1:
            arguments["q"] = _spoilt(moment.q, rng)
        elif kind == 2:
            free = problem.model.nq > problem.model.nv
            zero = moment.q.copy()
            zero[3:7] = 0.0
            wrong = (moment.q[:-1], moment.q[None], "q", [None] * moment.q.size, moment.q + 1j)
            arguments["q"] = self.drawer.among(*wrong, *([zero] * 3 if free else []))
        else:
            arguments["v"] = _spoilt(moment.v, rng)

    def _pushed(self, q: Array) -> Array:
        """Return a configuration that something has pushed the robot to."""
        problem, rng, drawer = self._problem, self.rng, self.drawer
        if drawer.chance(0.5):
            size = drawer.among(1e-6, 1e-4, 1e-3, 0.03, 0.3, 3.0)
            return random_configuration(problem.model, q, rng, size)
        box = problem.box
        ranged = np.flatnonzero(np.isfinite(box.lower))
        if ranged.size:
            joint = rng.choice(ranged)
            out = drawer.among(0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 100.0)
            upper = drawer.chance(0.5)
            q[box.coordinate[joint]] = box.upper[joint] + out if upper else box.lower[joint] - out
        return q

    def _change_limits(self) -> None:
        """Have other limits of velocity, acceleration and jerk from now on, and another range."""
        box, rng, drawer = self._problem.box, self.rng, self.drawer
        low, high = box.lower, box.upper
        if drawer.chance(0.3):
            room = np.where(np.isfinite(high - low), high - low, 0.0)
            low = low + 0.2 * room * rng.uniform(-1.0, 1.0, low.size)
            high = np.maximum(high + 0.2 * room * rng.uniform(-1.0, 1.0, low.size), low)
        if drawer.chance(0.3):
            limited = drawer.among(INF, drawer.between(1.0, 60.0))
            box = replace(box, acceleration=np.full(low.size, limited))
        if drawer.chance(0.3):
            box = replace(box, jerk=np.full(low.size, drawer.among(INF, drawer.between(50.0, 1e4))))
        factor = np.exp(rng.uniform(-1.0, 1.0, low.size))
        box = replace(box, lower=low, upper=high, velocity=box.velocity * factor)
        self._go_on(replace(self._problem, box=box), self._controller.q)

    def _move_obstacle(self) -> None:
        """Put the obstacle elsewhere near the robot, and let it move or rest."""
        rng, drawer, k = self.rng, self.drawer, self._mocap
        data = self._controller.engine.evaluation.data
        self._twist[k] = rng.normal(size=6) * 0.2 if drawer.chance(0.5) else 0.0
        position = data.mocap_pos[k].copy()
        if drawer.chance(0.5):
            near = data.xpos[rng.integers(1, len(data.xpos))]
            position = near + drawer.direction() * drawer.between(0.1, 1.0)
        self._controller.set_obstacle(OBSTACLE, position, velocity=self._twist[k])

    def _set_target(self, term: Term) -> bool:
        """Set a random target of the kind that the term has."""
        controller, rng, drawer = self._controller, self.rng, self.drawer
        problem, name = self._problem, term.name
        moving = rng.normal(size=6) * 0.3 if drawer.chance(0.3) else None
        away = drawer.direction() * drawer.among(0.0, 0.01, 0.1, 0.5, 3.0)
        if drawer.chance(0.05):
            away *= FAR
        kind = term.target_kind
        if kind == "pose":
            quaternion, position = term.target[:4], term.target[4:] + away
            if drawer.chance(0.3):
                quaternion = random_quaternion(rng) * drawer.among(1.0, 1e-6, -1.0, 2.0)
            done = controller.set_target(name, position, quaternion, moving)
        elif kind == "point":
            velocity = None if moving is None else moving[:3]
            done = controller.set_target(name, term.target + away, velocity=velocity)
        elif kind == "direction":
            done = controller.set_target(name, direction=drawer.direction())
        elif kind == "configuration":
            q = random_configuration(problem.model, problem.start, rng, drawer.among(0.1, 1.0, 9.0))
            done = controller.set_target(name, q=q)
        else:
            done = controller.set_target(name, velocity=term.target * rng.uniform(-1.0, 1.0))
        if done:
            self._ages[name] = self._now
        return done

    def _refused_target(self) -> bool:
        """Set a target that is none; return whether the controller refused it."""
        terms = [term for term in self._problem.terms if term.target_kind == "pose"]
        term = terms[self.rng.integers(len(terms))]
        bad = (
            {"position": [NAN, 0.0, 0.0]},
            {"position": [0.0, 1.0]},
            {"position": "there"},
            {"quaternion": [0.0, 0.0, 0.0, 0.0]},
            {"quaternion": [1e-20, 0.0, 0.0, 0.0]},
            {"quaternion": [1.0, INF, 0.0, 0.0]},
            {"velocity": [0.0, 0.0, NAN, 0.0, 0.0, 0.0]},
            {"q": self._problem.start},
        )
        if self._controller.set_target(term.name, **self.drawer.among(*bad)):
            raise Violation(f"a bad target was taken by {self.scene.name}, seed {self.seed}")
        return True
