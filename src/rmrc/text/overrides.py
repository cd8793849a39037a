"""Values set from outside, as in ``--set tasks.posture.B=0.1``."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from rmrc.errors import ConfigError, unknown_name
from rmrc.text.document import Node, Place
from rmrc.text.mistakes import Mistake, clipped, config_error, shown
from rmrc.text.read import DEEPEST, parse

_PATH = re.compile(r"[^.\[\]]+(?:\.[^.\[\]]+|\[\d{1,9}\])*")
_STEP = re.compile(r"[^.\[\]]+")


class _Unreachable(Exception):
    """The path leads nowhere; the message says why."""


def parse_override(text: str) -> tuple[str, Any]:
    """Return path and value of ``PATH=VALUE``, the value read as YAML.

    Raises:
        ConfigError: If there is no path or the value is no YAML.
    """
    path, equals, value = text.partition("=")
    place = Place(f"--set {clipped(text)}")
    if not equals or not _PATH.fullmatch(path):
        raise config_error([Mistake((), "write it as in --set solver.backend=osqp", place=place)])
    try:
        node = parse(value, place.file)
    except ConfigError as error:
        wrong = [replace(mistake, place=place) for mistake in error.mistakes]
        raise config_error(wrong) from None
    return path, None if node is None else node.plain


def parse_sweep(text: str) -> tuple[str, list[Any]]:
    """Return path and values of ``PATH=A,B,…``, the values read as YAML.

    Raises:
        ConfigError: If there is no path or no value, or they are no YAML.
    """
    path, equals, values = text.partition("=")
    place = Place(f"--sweep {clipped(text)}")
    try:
        path, found = parse_override(f"{path}{equals}[{values}]")
    except ConfigError:
        found = []
    if not found:
        raise config_error(
            [Mistake((), "write it as in --sweep damping.lambda=0.01,0.1", place=place)]
        )
    return path, found


def swept(sweeps: Iterable[tuple[str, Sequence[Any]]]) -> dict[str, dict[str, Any]]:
    """Return the overrides of every combination of values, by names as in `curvature=off`.

    Without any there is one, of the empty name.
    """
    several = [[(path, value) for value in values] for path, values in sweeps]
    return {
        " ".join(f"{_STEP.findall(path)[-1]}={_text(value)}" for path, value in chosen): dict(
            chosen
        )
        for chosen in product(*several)
    }


def apply(root: Node, overrides: Mapping[str, Any]) -> tuple[Node, list[Mistake]]:
    """Return the tree with values set, and the paths that lead nowhere.

    Args:
        root: The tree, stacks expanded.
        overrides: Values by path: keys with dots between them, the items of a list by position in
            brackets or by their `name`. A key that does not exist is made.
    """
    mistakes = []
    for path, value in overrides.items():
        place = Place(f"--set {clipped(path)}={clipped(_text(value))}")
        try:
            if not _PATH.fullmatch(path):
                raise _Unreachable("a path is written as in solver.backend or tasks[0].gain")
            steps = _STEP.findall(path)
            if len(steps) > DEEPEST:
                raise _Unreachable(f"a configuration is at most {DEEPEST} levels deep")
            root = _set(root, steps, "", _node(value, place))
        except _Unreachable as reason:
            mistakes.append(Mistake((), str(reason), place=place))
    return root, mistakes


def _set(node: Node, steps: list[str], above: str, value: Node) -> Node:
    """Return a copy of a node with the value at the end of the steps."""
    if not steps:
        return replace(value, key=value.place)
    step, *rest = steps
    inner = f"{above}.{step}" if above else step
    if isinstance(node.value, list):
        index = _index(node, step, above)
        items = list(node.value)
        items[index] = _set(items[index], rest, inner, value)
        return replace(node, value=items)
    if not isinstance(node.value, dict) and node.value is not None:
        raise _Unreachable(f"'{above}' is {shown(node.value)}, and nothing is inside it")
    child = node.mapping.get(step, Node(None, value.place, value.place))
    return replace(node, value={**node.mapping, step: _set(child, rest, inner, value)})


def _index(node: Node, step: str, above: str) -> int:
    names = [item.mapping["name"].value if "name" in item.mapping else "" for item in node.value]
    if step in names:
        return names.index(step)
    if not step.isdecimal():
        known = [name for name in names if isinstance(name, str)]
        raise _Unreachable(unknown_name(f"item of '{above}'", step, known))
    if int(step) >= len(names):
        raise _Unreachable(f"'{above}' has {len(names)} items, the first of them [0]")
    return int(step)


def _node(value: Any, place: Place) -> Node:
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        value = {str(key): _node(child, place) for key, child in value.items()}
    elif isinstance(value, (list, tuple)):
        value = [_node(item, place) for item in value]
    return Node(value, place, place)


def _text(value: Any) -> str:
    """Return a value as the option would have it."""
    match value:
        case None:
            return ""
        case bool():
            return str(value).lower()
    return str(value)
