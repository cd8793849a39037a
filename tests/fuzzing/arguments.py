"""Hostile arguments into the extension's own classes: an exception, or an engine that still steps.

What the package hands over is changed on the way, one argument in a problem: another number, index,
length, type or kind of array. The addresses of MuJoCo's functions are left alone: nothing can tell
whether they are what they should be.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

import rmrc
import rmrc.control.fast.batch
import rmrc.native.engine  # these are loaded on use, and name the classes as they are
from fuzzing import scenes
from fuzzing.numbers import AWKWARD, NOT_FINITE, Generator, among
from rmrc import _native
from rmrc.errors import RmrcError

INTEGERS = (-1, 0, 1, 7, 60, 10_000, 2**31 - 1, -(2**31), 2**40)
CLASSES = ("Engine", "Rows", "Shortening", "ForwardKinematics", "Stepper", "Batch")
FUNCTIONS = (*CLASSES, "TermRows", "Frame", "Kinematics", "hold", "descend")
UNTOUCHED = ("functions", "owner")
MOST_CALLS = 120
"""A problem makes about as many calls: the one that is changed is among them, as a rule."""
ROUNDS = 8
"""Times that a problem is built, each with another change."""


def changed(rng: Generator, value: Any) -> Any:
    """Return something else than a value."""
    match value:
        case bool():
            return not value
        case int():
            return among(rng, *INTEGERS, value + 1, value - 1)
        case float():
            return float(among(rng, *AWKWARD, *NOT_FINITE))
        case str():
            return among(rng, "none", "body", "")
        case list() | tuple():
            return type(value)(changed_items(rng, list(value)))
        case dict():
            found = dict(value)
            if found:
                name = among(rng, *found)
                if rng.random() < 0.3:
                    del found[name]
                else:
                    found[name] = changed(rng, found[name])
            return found
        case np.ndarray():
            return changed_array(rng, value)
        case _:
            return among(rng, None, 0, object())


def changed_items(rng: Generator, items: list[Any]) -> list[Any]:
    """Return a list that is longer or shorter, or has one item changed."""
    if not items or rng.random() < 0.1:
        return [*items, *items[:1], *([0] if not items else [])]
    k = int(rng.integers(len(items)))
    if rng.random() < 0.2:
        return items[:k] + items[k + 1 :]
    return [*items[:k], changed(rng, items[k]), *items[k + 1 :]]


def changed_array(rng: Generator, array: np.ndarray) -> np.ndarray:
    """Return an array of another length, type, order or content."""
    match rng.integers(7):
        case 0:
            return array.reshape(-1)[: array.size // 2]
        case 1:
            return np.concatenate([array.reshape(-1)] * 2)
        case 2:
            return array.astype(np.float32)
        case 3:
            return np.repeat(array.reshape(-1), 2)[::2]
        case 4:
            frozen = array.copy()
            frozen.flags.writeable = False
            return frozen
        case 5:
            return np.zeros(0, dtype=array.dtype)
        case _:
            other = array.copy()
            if other.size:
                wild = INTEGERS if other.dtype.kind == "i" else (*AWKWARD, *NOT_FINITE)
                if other.dtype.kind in "iuf" and other.dtype.itemsize == 8:
                    other.flat[rng.integers(other.size)] = among(rng, *wild)
            return other


class Saboteur:
    """Changes an argument of one call among those to come."""

    def __init__(self, rng: Generator):
        self._rng, self._calls = rng, 1 + int(rng.integers(MOST_CALLS))

    @property
    def done(self) -> bool:
        """Whether the call has come."""
        return self._calls <= 0

    def wrapped(self, function: Callable[..., Any], first: int) -> Callable[..., Any]:
        """Return a function whose arguments from `first` on may be changed."""

        def call(*args: Any, **kwargs: Any) -> Any:
            self._calls -= 1
            if self._calls == 0:
                given = [*range(first, len(args)), *(k for k in kwargs if k not in UNTOUCHED)]
                if given:
                    at = given[self._rng.integers(len(given))]
                    if isinstance(at, int):
                        other = changed(self._rng, args[at])
                        args = (*args[:at], other, *args[at + 1 :])
                    else:
                        kwargs[at] = changed(self._rng, kwargs[at])
            return function(*args, **kwargs)

        return call


@contextmanager
def sabotaged(rng: Generator) -> Iterator[Saboteur]:
    """Have one call of the extension changed until the end of the block."""
    saboteur, before = Saboteur(rng), []

    def replace(owner: Any, name: str, first: int) -> None:
        function = getattr(owner, name)
        before.append((owner, name, function))
        setattr(owner, name, saboteur.wrapped(function, first))

    classes = [getattr(_native, name) for name in CLASSES]
    for name in FUNCTIONS:
        replace(_native, name, 0)
    for kind in classes:
        for name in [n for n, f in vars(kind).items() if callable(f) and not n.startswith("_")]:
            replace(kind, name, 1)
    try:
        yield saboteur
    finally:
        for owner, name, function in before:
            setattr(owner, name, function)


def run(rng: Generator, folder: Path) -> int:
    """Build a random problem's controllers with a changed argument, and step what comes of it.

    Return how often.
    """
    config = scenes.config(rng, folder)
    if config is None:
        return 0
    try:
        problem = rmrc.compile(config)
    except RmrcError:
        return 0
    return sum(build(rng, problem) for _ in range(ROUNDS))


def build(rng: Generator, problem: rmrc.Problem) -> bool:
    """Return whether an argument was changed on the way; it is the sanitizers that look."""
    with sabotaged(rng) as saboteur, suppress(Exception):
        controller = rmrc.Controller(problem, engine="native")
        batch = rmrc.BatchController(problem, 3, threads=2)
        for _ in range(3):
            controller.step(dt=float(among(rng, 1e-3, 0.1)))
            batch.step()
    return saboteur.done
