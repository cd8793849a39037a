"""A random walk of a controller: targets, pushes, limits that change, and bad inputs."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
from pydantic import ValidationError

import rmrc
from models import random_configuration, random_quaternion
from rmrc.control.step import Step
from rmrc.problem.problem import Problem
from rmrc.tasks.base import Term
from soaking.checks import TOLERANCE, Checker, Moment, carried
from soaking.contract import Contract
from soaking.drawer import Array, Drawer, Generator
from soaking.figures import Figures
from soaking.reduction import Taken
from soaking.scenes import Drawn, Scene, Trees

NAN, INF = float("nan"), float("inf")
FAR = 1e6
"""How many times as far away a target is that has gone astray."""
JUMPS = (1e-9, 1e-6, 0.1, 1.0)
"""Lengths in s of the step that comes now and then from a clock that has stood still or jumped."""
ASTRAY = 1e11
"""Largest number in a state from which the robot goes on; beyond it, it starts anew at rest."""
LATE = 1e-9
"""Rounding of a sum of times, s."""
NATIVE = 0.7
"""Share of the episodes that the native engine may take; the Python engine takes the others."""
ATTEMPTS = 50
"""Configurations of a tree that are drawn before one has to fit."""
OVERTIME = 0.02
"""Time in s of its thread that a native step may take beyond its deadline: that of a few
evaluations of the rows of the largest trees, and of what the system does in between."""


class Violation(AssertionError):
    """A step that broke a promise, and how to run it again."""


def _spoilt(array: Array, rng: Generator) -> Array:
    spoilt = array.copy()
    spoilt[rng.integers(array.size)] = (NAN, INF, -INF, 1e300)[rng.integers(4)]
    return spoilt


class Episode:
    """Steps of one random configuration of a scene; the same seed gives the same ones."""

    def __init__(self, scene: Scene | Trees, seed: int, folder: Path, native: float = NATIVE):
        self.scene, self.seed, self._native = scene, seed, native
        self.rng = np.random.default_rng([crc32(scene.name.encode()), seed])
        self.drawer = Drawer(self.rng)
        self.drawn = Drawn({})
        self.refused = 0
        """Configurations that were drawn before, and that the package refuses."""
        try:
            self._begin(folder)
        except Violation:
            raise
        except Exception as raised:
            raise Violation(self._message(0, f"raised {raised!r} before")) from raised

    def _begin(self, folder: Path) -> None:
        self._number = 0
        self._problem = self._compiled(folder)
        self._jitter = self.drawer.chance(0.4)
        self._measured = self.drawer.chance(0.5)
        self._noise = self.drawer.among(0.0, 0.0, 1e-6, 1e-3)
        self._brisk = 3.0 if isinstance(self.scene, Trees) else 1.0
        """How often targets and obstacles move, beside the long episodes of the other scenes."""
        self._rough = self.drawer.among(0.0, 1.0, 1.0, 3.0)
        """How often something happens, beside what is usual."""
        model = self._problem.model
        self._contract = Contract(self._problem.config, model)
        if different := self._contract.differences(self._problem.box, self._problem.dofs):
            raise Violation(self._message(0, f"limits are not those asked for: {different}"))
        self._changed = False
        """Whether the limits are no longer those of the configuration."""
        self._taken: Taken | None = None
        self._twist = np.zeros((model.nmocap, 6))
        self._movers = {
            int(model.body_mocapid[body]): model.body(body).name
            for body in np.flatnonzero(model.body_mocapid >= 0).tolist()
        }
        self._v, self._a = np.zeros((2, model.nv))
        self._go_on(self._problem, self._start())

    def _compiled(self, folder: Path) -> Problem:
        """Return the problem of the first configuration drawn that fits its scene."""
        engine = "auto" if self.drawer.chance(self._native) else "python"
        for _ in range(ATTEMPTS):
            self.drawn = self.scene.draw(self.seed, folder, self.rng)
            self.drawn.config["engine"] = engine
            try:
                return rmrc.compile(rmrc.Config.model_validate(self.drawn.config))
            except (rmrc.errors.ConfigError, ValidationError):
                if isinstance(self.scene, Scene):
                    raise
                self.refused += 1
        raise Violation(self._message(0, "no configuration of this tree is accepted"))

    @property
    def engine(self) -> str:
        """The engine that takes the steps."""
        return self._controller.engine.name

    def _start(self) -> Array:
        """Return the start, or a configuration with many joints near the ends of their range."""
        box, q = self._problem.box, self._problem.start.copy()
        ranged = np.flatnonzero(np.isfinite(box.upper - box.lower))
        closed = any(term.type == "loop" for term in self._problem.terms)
        if self.drawer.chance(0.1 if closed else 0.5):
            share = self.rng.beta(0.3, 0.3, ranged.size)
            between = (1.0 - share) * box.lower[ranged] + share * box.upper[ranged]
            q[box.coordinate[ranged]] = between
        return q

    def _go_on(self, problem: Problem, q: Array) -> None:
        """Have another problem from now on, at a configuration and with the present velocity."""
        self._problem = problem
        self._controller = rmrc.Controller(problem)
        self._controller.reset(q, self._v, self._a)
        self._checker = Checker(problem, self._contract)
        self._ages: dict[str, float] = {}
        self._now = self._measured_at = 0.0
        self._mocap, self._turned = (array.copy() for array in self._contract.mocap)
        self._twist[:] = 0.0

    def run(self, count: int, figures: Figures, reduces: bool = False) -> Iterator[int]:
        """Take some steps; yield the number of those done.

        Args:
            count: How many steps.
            figures: What takes note of them.
            reduces: Whether a broken promise is told by the least that breaks it, too.

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
                least = self._reduced({"raised"}) if reduces else ""
                raise Violation(self._message(k, f"raised {raised!r}") + least) from raised
            self._advance(moment, step)
            figures.add(self.scene.name, step, found, moment.braking)
            wrong = {kind: x for kind, x in found.items() if not x <= TOLERANCE[kind]}
            if wrong:
                said = ", ".join(f"{kind} by {excess:.3g}" for kind, excess in wrong.items())
                least = self._reduced(set(wrong)) if reduces else ""
                raise Violation(self._message(k, f"{said} ({step.status.name})") + least)
            figures.kkt = max(figures.kkt, found.get("certificate", 0.0))
            yield k + 1

    def _reduced(self, broken: set[str]) -> str:
        """Return the least that breaks the same promises at the last step."""
        if self._taken is None:
            return ""
        self._taken.broken = frozenset(broken)
        return f"\n  {self._taken.told()}"

    def _message(self, k: int, said: str) -> str:
        engine = self.drawn.config.get("engine")
        where = f"at step {k} of {self.scene.name}, engine {engine}"
        return f"{said} {where}; again: {self._again(k)}\n  {self.drawn.said}\n  {self._told()}"

    def _told(self) -> str:
        """Return the configuration in a line."""
        return json.dumps(self.drawn.config)

    def _again(self, k: int) -> str:
        share = "" if self._native == NATIVE else f" --native {self._native}"
        return f"bench/soak.py --scene {self.scene.name} --seed {self.seed} --steps {k + 1}{share}"

    def _advance(self, moment: Moment, step: Step) -> None:
        """Go where the command leads."""
        self._now += moment.dt
        self._v, self._a = step.v.copy(), (step.v - moment.v) / moment.dt
        if max(np.abs(step.q).max(), np.abs(self._v).max(), np.abs(self._a).max()) > ASTRAY:
            self._v[:], self._a[:] = 0.0, 0.0  # without limits and damping it may get anywhere
            self._go_on(self._problem, self._problem.start)
            return
        if self._twist.any():
            self._mocap, self._turned = carried(self._mocap, self._turned, self._twist, moment.dt)
            for k in np.flatnonzero(self._twist.any(axis=1)).tolist():
                self._place_mover(k)

    def _place_mover(self, k: int) -> None:
        self._turned[k] /= np.linalg.norm(self._turned[k])
        place = (self._mocap[k], self._turned[k], self._twist[k])
        if not self._controller.set_obstacle(self._movers[k], *place):
            raise Violation(self._message(self._number, "a good obstacle was refused"))

    def _often(self, share: float) -> bool:
        return self.drawer.chance(share * self._rough)

    def _step(self, figures: Figures) -> tuple[Moment, Step]:
        """Let something happen, and take a step."""
        rests = True
        if self._often(0.004):
            self._change_limits()
        if self._movers and self._often(0.01 * self._brisk):
            self._move_obstacle()
            rests = False
        refused = False
        renewed = (self._is_late() and self.drawer.chance(0.3)) or self._number == 0
        for term in self._problem.terms:
            if term.target.size and (renewed or self._often(0.03 * self._brisk)):
                refused |= not self._set_target(term)
                rests = False
        if self._often(0.01):
            refused |= self._refused_target()
        arguments, moment = self._inputs()
        moment.invalid |= refused
        problem, evaluation = self._problem, self._controller.engine.evaluation
        targets = {
            term.name: (
                term.target_kind,
                evaluation.target[term.name].copy(),
                evaluation.twist[term.name].copy()
                if evaluation.moving[evaluation.index[term.name]]
                else None,
            )
            for term in problem.terms
        }
        moved = 1 in evaluation.moving or bool(self._twist.any())
        # A rate of e/dt goes up and down with a dt that does.
        moment.rest = rests and not moved and moment.dt == problem.dt
        box = problem.box if self._changed else None
        self._taken = Taken(self.drawn.config, box, targets, moment, arguments, frozenset())
        bounded = problem.deadline < INF and self.engine == "native"
        clock = thread_time if bounded else perf_counter  # what other processes take is not ours
        begin = clock()
        step = self._controller.step(**arguments)
        seconds = clock() - begin
        if bounded:
            moment.overtime = seconds - problem.deadline - OVERTIME
        figures.time(self.engine, seconds, problem.deadline, self._again(self._number))
        if problem.config.previous == "measured" and not moment.braking:
            # Of a joint that slows down it counts from the last command, and never from beyond.
            ends = np.sort([moment.v, self._v, np.zeros_like(self._v)], axis=0)
            moment.v = np.clip(step.moment.v_previous, ends[0], ends[2])
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
        mocap = (self._mocap.copy(), self._turned.copy(), self._twist.copy())
        moment = Moment(q, v, a, dt, mocap, braking=False, invalid=False)
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
            zero, kinds = moment.q.copy(), problem.model.jnt_type
            free = bool((kinds < int(mujoco.mjtJoint.mjJNT_SLIDE)).any())
            for joint in np.flatnonzero(kinds < int(mujoco.mjtJoint.mjJNT_SLIDE)):
                last = problem.model.jnt_qposadr[joint] + (7 if kinds[joint] == 0 else 4)
                zero[last - 4 : last] = 0.0
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
            limited = drawer.among(INF, drawer.between(1.0, 60.0) * self.drawn.rate**2)
            box = replace(box, acceleration=np.full(low.size, limited))
        if drawer.chance(0.3):
            jerk = drawer.between(50.0, 1e4) * self.drawn.rate**3
            box = replace(box, jerk=np.full(low.size, drawer.among(INF, jerk)))
        factor = np.exp(rng.uniform(-1.0, 1.0, low.size))
        box = replace(box, lower=low, upper=high, velocity=box.velocity * factor)
        self._contract.take(box, self._problem.dofs)
        self._changed = True
        self._go_on(replace(self._problem, box=box), self._controller.q)

    def _now_at(self) -> mujoco.MjData:
        """Return the kinematics of now."""
        model = self._problem.model
        data = mujoco.MjData(model)
        data.qpos, data.mocap_pos, data.mocap_quat = self._controller.q, self._mocap, self._turned
        mujoco.mj_kinematics(model, data)
        return data

    def _move_obstacle(self) -> None:
        """Put an obstacle elsewhere near the robot, and let it move or rest."""
        rng, drawer, length = self.rng, self.drawer, self.drawn.length
        k = drawer.among(*self._movers)
        speed = 0.2 * self.drawn.rate * np.repeat([length, 1.0], 3)
        self._twist[k] = rng.normal(size=6) * speed if drawer.chance(0.5) else 0.0
        if drawer.chance(0.5):
            data = self._now_at()
            near = data.xpos[rng.integers(1, len(data.xpos))]
            self._mocap[k] = near + drawer.direction() * drawer.between(0.1, 1.0) * length
        self._place_mover(k)

    def _set_target(self, term: Term) -> bool:
        """Set a random target of the kind that the term has."""
        controller, rng, drawer = self._controller, self.rng, self.drawer
        problem, name = self._problem, term.name
        length, rate = self.drawn.length, self.drawn.rate
        speed = 0.3 * rate * np.repeat([length, 1.0], 3)
        moving = rng.normal(size=6) * speed if drawer.chance(0.3) else None
        away = drawer.direction() * length * drawer.among(0.0, 0.01, 0.1, 0.5, 3.0)
        if drawer.chance(0.05):
            away *= FAR
        kind = term.target_kind
        place = term.target[-3:] + away if kind in ("pose", "point") else away
        if self._contract.pairs.size and drawer.chance(0.5):  # into what it must not touch
            place = self._now_at().geom_xpos[drawer.among(*self._contract.pairs.ravel())].copy()
        if kind == "pose":
            quaternion, position = term.target[:4], place
            if drawer.chance(0.3):
                quaternion = random_quaternion(rng) * drawer.among(1.0, 1e-6, -1.0, 2.0)
            done = controller.set_target(name, position, quaternion, moving)
        elif kind == "point":
            velocity = None if moving is None else moving[:3]
            done = controller.set_target(name, place, velocity=velocity)
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
        if not terms:
            return False
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
            raise Violation(self._message(self._number, "a bad target was taken"))
        return True
