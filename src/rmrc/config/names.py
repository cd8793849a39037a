"""Names in a configuration: those of the MuJoCo model, and those of its own tasks."""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import mujoco

from rmrc.errors import unknown_name
from rmrc.model.frames import names
from rmrc.text.annotations import NameKind, NameOf, bare, choose, entries, inside, members, tag_key
from rmrc.text.document import Location
from rmrc.text.mistakes import MOST_MISTAKES, Mistake, clipped

Named = tuple[Location, NameKind, str, bool]
"""Where a name is, of what, the name, and whether it is a key."""

ALL = " (`rmrc inspect` lists all names)"
"""Where a reader finds what a message cuts short."""

FOLLOWING = ("pose", "point")
"""The kinds of targets that can follow a path."""


def names_in(annotation: Any, value: Any, location: Location = ()) -> Iterator[Named]:
    """Yield every name of the model in data, which may have any other mistake.

    Args:
        annotation: The type that the data is meant for.
        value: Plain data.
        location: Where it is.
    """
    yield from _named(annotation, value, location, False)
    if members(annotation) or tag_key(annotation):
        member = choose(annotation, value)
        if member is not None:
            yield from names_in(member, value, location)
        return
    for step, child in entries(value):
        below = inside(annotation, step)
        if below is not None:
            key, wanted = below
            yield from _named(key, step, (*location, step), True)
            yield from names_in(wanted, child, (*location, step))


def _named(annotation: Any, value: Any, location: Location, at_key: bool) -> Iterator[Named]:
    if isinstance(value, str):
        for item in bare(annotation)[1]:
            if isinstance(item, NameOf):
                yield location, item.kind, value, at_key


def unknown_names(annotation: Any, value: Any, model: mujoco.MjModel) -> list[Mistake]:
    """Return the names in data that the model does not have, as far as a reader wants to know."""
    known: dict[str, dict[str, None]] = {}
    wrong = (
        Mistake(location, f"{unknown_name(kind, clipped(name), known[kind])}{ALL}", at_key)
        for location, kind, name, at_key in names_in(annotation, value)
        if name not in known.setdefault(kind, dict.fromkeys(_names(model, kind)))
    )
    return list(islice(wrong, MOST_MISTAKES + 1))


def _names(model: mujoco.MjModel, kind: NameKind) -> list[str]:
    """Return the names that the model has of one kind, or of either of two: `geom or body`."""
    return [name for part in kind.split(" or ") for name in names(model, part)]


def disagreements(tasks: Iterable[tuple[int, str, str]], targets: Iterable[str]) -> list[Mistake]:
    """Return what does not fit together in the names, as far as a reader wants to know.

    Args:
        tasks: Position, name and kind of target of each task.
        targets: The names that have a path.
    """
    return list(islice(_disagreeing(tasks, targets), MOST_MISTAKES + 1))


def _disagreeing(
    tasks: Iterable[tuple[int, str, str]], targets: Iterable[str]
) -> Iterator[Mistake]:
    first: dict[str, tuple[int, str]] = {}
    for index, name, kind in tasks:
        if name in first:
            yield Mistake(
                ("tasks", index, "name"),
                f"two tasks are named '{clipped(name)}', and names must differ",
                other=("tasks", first[name][0], "name"),
            )
        first.setdefault(name, (index, kind))
    for name in targets:
        if name not in first:
            message = unknown_name("task", clipped(name), first)
            yield Mistake(("targets", name), message, key=True)
        elif first[name][1] not in FOLLOWING:
            message = f"the task '{name}' follows no path: its type has no pose and no point"
            yield Mistake(("targets", name), message, key=True)
