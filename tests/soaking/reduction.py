"""A broken promise in few words: the step by itself, with what of its configuration it takes."""

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

import rmrc
from rmrc.limits.box import Box
from soaking.checks import TOLERANCE, Checker, Moment
from soaking.contract import Contract
from soaking.drawer import Array

Data = dict[str, Any]
ATTEMPTS = 200
"""Configurations that are tried."""


@dataclass
class Taken:
    """All that a step was taken from, but for what its controller remembered of earlier ones."""

    config: Data
    box: Box | None
    """The limits of the joints, where they have changed on the way."""
    targets: dict[str, tuple[str, Array, Array | None]]
    """Kind, value and twist of each target."""
    moment: Moment
    arguments: Data
    broken: frozenset[str]
    """The promises that were broken."""

    def again(self, config: Data) -> bool:
        """Return whether a configuration breaks one of the same promises from the same place."""
        try:
            problem = rmrc.compile(rmrc.Config.model_validate(config))
        except (rmrc.errors.RmrcError, ValidationError):
            return False
        if self.box is not None and self.box.lower.size != problem.dofs.size:
            return False
        contract, moment = Contract(problem.config, problem.model), self.moment
        if self.box is not None:
            contract.take(self.box, problem.dofs)
            problem = replace(problem, box=self.box)
        try:
            controller = rmrc.Controller(problem)
            controller.reset(moment.q, moment.v, moment.a)
            _surround(controller, problem.model, moment)
            for name, target in self.targets.items():
                if name in problem.term:
                    _aim(controller, name, *target)
            step = controller.step(**self.arguments)
            found = Checker(problem, contract).check(moment, step, controller)
        except Exception:
            return "raised" in self.broken
        return any(not x <= TOLERANCE[kind] for kind, x in found.items() if kind in self.broken)

    def told(self) -> str:
        """Return the least configuration found that does it, with the state, in a few lines."""
        if not self.again(self.config):
            return "the step alone, from a controller without a past, does not do it"
        config = reduced(self.config, self.again)
        moment = self.moment
        state = {"q": moment.q.tolist(), "v": moment.v.tolist(), "dt": moment.dt}
        for name, (_, value, twist) in self.targets.items():
            if name in {task["name"] for task in config["tasks"]}:
                state[name] = [value.tolist(), None if twist is None else twist.tolist()]
        if moment.mocap[0].size:
            state["mocap"] = [part.tolist() for part in moment.mocap]
        changed = "" if self.box is None else ", with limits that have changed"
        return f"the step alone does it{changed}: {json.dumps(config)}\n  from {json.dumps(state)}"


def reduced(config: Data, fails: Callable[[Data], bool], attempts: int = ATTEMPTS) -> Data:
    """Return a configuration from which nothing can be left out without its passing."""
    while True:
        for smaller in _smaller(config):
            attempts -= 1
            if attempts < 0:
                return config
            if fails(smaller):
                config = smaller
                break
        else:
            return config


def _smaller(config: Data) -> Iterator[Data]:
    """Yield a configuration without each of its parts."""
    for path in _parts(config):
        smaller = copy.deepcopy(config)
        inside: Any = smaller
        for key in path[:-1]:
            inside = inside[key]
        del inside[path[-1]]
        yield smaller


def _parts(config: Data) -> Iterator[tuple[Any, ...]]:
    """Yield where the parts are that a configuration can do without."""
    for k in range(len(config["tasks"]) if len(config["tasks"]) > 1 else 0):
        yield "tasks", k
    for key, value in config["limits"].items():
        yield "limits", key
        if isinstance(value, dict):
            yield from (("limits", key, inner) for inner in value)
            pairs = value.get("pairs")
            if isinstance(pairs, list) and len(pairs) > 1:
                yield from (("limits", key, "pairs", k) for k in range(len(pairs)))
    for key in config:
        if key not in ("scene", "tasks", "limits", "dt", "engine"):
            yield (key,)
    for k, task in enumerate(config["tasks"]):
        kept = ("name", "type", "frame", "root", "target", "joints", "coefficients", "pairs")
        yield from (("tasks", k, key) for key in task if key not in kept)


def _surround(controller: rmrc.Controller, model: Any, moment: Moment) -> None:
    position, quaternion, twist = moment.mocap
    for body in range(model.nbody):
        k = int(model.body_mocapid[body])
        if k >= 0:
            name = model.body(body).name
            controller.set_obstacle(name, position[k], quaternion[k], twist[k])


def _aim(
    controller: rmrc.Controller, name: str, kind: str, value: Array, twist: Array | None
) -> None:
    if kind == "pose":
        controller.set_target(name, value[4:], value[:4], twist)
    elif kind == "point":
        controller.set_target(name, value, velocity=None if twist is None else twist[:3])
    elif kind == "direction":
        controller.set_target(name, direction=value)
    elif kind == "configuration":
        controller.set_target(name, q=value)
    elif kind == "rates":
        controller.set_target(name, velocity=value)
