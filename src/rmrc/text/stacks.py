"""Stacks: reusable lists of tasks and limits that a configuration takes in with `use`."""

import re
from collections.abc import Mapping
from dataclasses import replace
from os.path import normpath
from pathlib import Path
from typing import Any, NoReturn

from rmrc.errors import ConfigError, unknown_name
from rmrc.text.document import Node, Place
from rmrc.text.mistakes import MOST_MISTAKES, Mistake, clipped, shown
from rmrc.text.read import LONGEST_TEXT, MOST_VALUES, read, too_long

USE_KEYS = ("use", "with", "override")
STACK_KEYS = ("parameters", "tasks", "limits")

PARAMETER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WHOLE = re.compile(r"\$(\w+)|\$\{(\w+)\}")
_PART = re.compile(r"(\$\$)|\$\{(\w+)\}|\$")
# So many characters put into a text count as one value, which bounds what a stack grows to.
_CHARACTERS = 20


def expand(root: Node, file: Path, name: str) -> tuple[Node, list[Mistake]]:
    """Return the tree of a configuration with its stacks' tasks and limits in it.

    The configuration's own limits win over those of stacks.

    Args:
        root: The tree of the file.
        file: The file, which the paths of stacks are relative to.
        name: How messages call it.
    """
    items = root.child("tasks")
    if items is None or not isinstance(items.value, list):
        return root, []
    expansion = _Expansion(file, name)
    own = root.child("limits")
    tasks: list[Node] = []
    limits: Node | None = None
    for item in items.value:
        if len(expansion.mistakes) > MOST_MISTAKES:
            break
        if "use" not in item.mapping:
            tasks.append(item)
            continue
        try:
            stack = expansion.stack(item)
        except _Unusable:
            continue
        tasks += stack["tasks"].value
        limits = expansion.joined(limits, stack.get("limits"), own)
    entries = {**root.mapping, "tasks": replace(items, value=tasks)}
    if limits is not None:
        entries["limits"] = limits if own is None else merged(limits, own)
    return replace(root, value=entries), expansion.mistakes


def merged(under: Node, over: Node) -> Node:
    """Return `over`, or two mappings as one in which it wins."""
    if not isinstance(under.value, dict) or not isinstance(over.value, dict):
        return over
    entries = dict(under.value)
    for key, node in over.value.items():
        entries[key] = merged(entries[key], node) if key in entries else node
    return replace(under, value=entries)


class _Unusable(Exception):
    """A stack cannot be used; why is among the mistakes."""


class _Expansion:
    """Takes stacks in, one `use` after another, and collects the mistakes."""

    def __init__(self, file: Path, name: str):
        self.mistakes: list[Mistake] = []
        self._file, self._name = file, name
        self._read: dict[str, Node | None] = {}
        self._room = MOST_VALUES

    def stack(self, item: Node) -> dict[str, Node]:
        """Return the tasks, and the limits if it has any, of the stack that an item uses.

        Raises:
            _Unusable: If there is no such stack or the item does not fit it.
        """
        self._check_item(item)
        given, edits = self._section(item, "with"), self._section(item, "override")
        use = item.mapping["use"]
        stack = self._used(self._stack_of(item), use.anchor)
        self._check_stack(stack)
        values = self._values(self._section(stack, "parameters"), given, use)
        empty = Node([], stack.place)
        parts = {"tasks": empty} | {
            key: self._filled(node, values)
            for key, node in stack.mapping.items()
            if key != "parameters"
        }
        self._check_tasks(parts["tasks"])
        return self._edited(parts, edits)

    def joined(self, first: Node | None, second: Node | None, own: Node | None) -> Node | None:
        """Return two stacks' limits as one; where they differ the configuration must decide."""
        if first is None or second is None:
            return second if first is None else first
        if own is not None and not isinstance(own.value, dict):
            return first  # which does not matter, for the configuration's own wins
        if isinstance(first.value, dict) and isinstance(second.value, dict):
            entries: dict[str, Any] = dict(first.value)
            for key, node in second.value.items():
                inner = own.child(key) if own is not None else None
                entries[key] = self.joined(entries.get(key), node, inner)
            return replace(first, value=entries)
        if first.plain != second.plain:
            self._note(
                f"two stacks disagree on this limit: it is {shown(second.value)} here and "
                f"{shown(first.value)} at {first.anchor}; decide in the configuration's limits",
                second.anchor,
            )
        return first

    def _stack_of(self, item: Node) -> Node:
        """Read the file that an item names, once."""
        use = item.mapping["use"]
        if not isinstance(use.value, str) or not use.value:
            self._stop(f"the path of a stack is wanted here, not {shown(use.value)}", use.anchor)
        name = normpath(Path(self._name).parent / use.value)
        if name not in self._read:
            self._read[name] = None
            try:
                self._read[name] = read(self._file.parent / use.value, name)
            except ConfigError as error:
                for mistake in error.mistakes:
                    place = mistake.place
                    whole = place is None or not place.line
                    message = f"{name}: {mistake.message}" if whole else mistake.message
                    self._note(message, use.anchor if place is None or whole else place)
        stack = self._read[name]
        if stack is None:
            raise _Unusable
        return stack

    def _used(self, node: Node, use: Place) -> Node:
        """Return a stack's node with the place of its use noted on every place in it."""
        self._take(node, 1)
        value: Any = node.value
        if isinstance(value, dict):
            value = {key: self._used(child, use) for key, child in value.items()}
        elif isinstance(value, list):
            value = [self._used(item, use) for item in value]
        key = replace(node.key, use=use) if node.key else None
        return Node(value, replace(node.place, use=use), key)

    def _values(self, defaults: Node | None, given: Node | None, use: Node) -> dict[str, Node]:
        """Return the parameters' values: the defaults, and over them what `with` gives."""
        values = dict(defaults.mapping) if defaults is not None else {}
        before = len(self.mistakes)
        for name, node in values.items():
            if not PARAMETER.fullmatch(name):
                message = f"a parameter's name is of letters, digits and _, not '{clipped(name)}'"
                self._note(message, node.key or node.place)
        for name, node in given.mapping.items() if given is not None else ():
            if name not in values and len(self.mistakes) <= MOST_MISTAKES:
                message = unknown_name(f"parameter of {use.value}", clipped(name), values)
                self._note(message, node.key or node.place)
        values.update(given.mapping if given is not None else {})
        missing = [name for name, node in values.items() if node.value is None]
        if missing and len(self.mistakes) == before:
            example = ", ".join(f"{name}: …" for name in missing)
            self._note(
                f"{use.value} has no default for {', '.join(missing)}: give it, as in "
                f"'with: {{{example}}}'",
                (given or use).anchor,
            )
        if len(self.mistakes) > before:
            raise _Unusable
        return values

    def _filled(self, node: Node, values: Mapping[str, Node]) -> Node:
        """Return a part of a stack with values, placed where they were written, for parameters."""
        if isinstance(node.value, dict):
            entries: dict[str, Node] = {}
            for key, child in node.value.items():
                name = self._text(key, child.anchor, values)
                if name in entries:
                    self._stop(f"two keys here become '{clipped(name)}'", child.anchor)
                entries[name] = self._filled(child, values)
            return replace(node, value=entries)
        if isinstance(node.value, list):
            return replace(node, value=[self._filled(item, values) for item in node.value])
        if not isinstance(node.value, str):
            return node
        whole = _WHOLE.fullmatch(node.value)
        if whole is None:
            return replace(node, value=self._text(node.value, node.place, values))
        value = self._value(whole[1] or whole[2], node.place, values)
        self._take(node, _size(value))
        return replace(value, key=node.key)

    def _text(self, text: str, place: Place, values: Mapping[str, Node]) -> str:
        """Return a text with ${name} replaced by text and $$ by a dollar."""

        def part(match: re.Match[str]) -> str:
            if match[1]:
                return "$"
            if not match[2]:
                self._stop("write $$ for a dollar, and ${name} for a parameter inside text", place)
            node = self._value(match[2], place, values)
            if isinstance(node.value, bool) or not isinstance(node.value, (str, int, float)):
                message = f"'{match[2]}' stands inside text at {place}: give text or a number"
                self._stop(f"{message}, not {shown(node.value)}", node.anchor)
            inserted = str(node.value)
            self._take(node, 1 + len(inserted) // _CHARACTERS)
            return inserted

        filled = _PART.sub(part, text)
        if len(filled) > LONGEST_TEXT:
            self._stop(too_long(filled), place)
        return filled

    def _value(self, name: str, place: Place, values: Mapping[str, Node]) -> Node:
        if name not in values:
            self._stop(unknown_name("parameter", clipped(name), values), place)
        return values[name]

    def _check_tasks(self, tasks: Node) -> None:
        if not isinstance(tasks.value, list):
            self._stop(f"a list of tasks is wanted here, not {shown(tasks.value)}", tasks.anchor)
        for item in tasks.value:
            if "use" in item.mapping:
                message = "a stack cannot use a stack: let the configuration use both"
                self._stop(message, item.mapping["use"].anchor)

    def _edited(self, parts: dict[str, Node], edits: Node | None) -> dict[str, Node]:
        """Return the parts with `override` merged into tasks, by name, and limits."""
        tasks = list(parts["tasks"].value)
        names = [item.mapping["name"].value if "name" in item.mapping else "" for item in tasks]
        limits = parts.get("limits")
        for name, edit in edits.mapping.items() if edits is not None else ():
            if not isinstance(edit.value, dict):
                message = f"keys and values are wanted here, not {shown(edit.value)}"
                self._stop(message, edit.anchor)
            if name == "limits":
                limits = edit if limits is None else merged(limits, edit)
            elif name in names:
                index = names.index(name)
                tasks[index] = merged(tasks[index], edit)
            else:
                known = [name for name in names if isinstance(name, str)]
                message = unknown_name("task in the stack", clipped(name), known)
                self._stop(message, edit.key or edit.place)
        edited = {"tasks": replace(parts["tasks"], value=tasks)}
        return edited if limits is None else {**edited, "limits": limits}

    def _section(self, node: Node, key: str) -> Node | None:
        """Return a mapping under a key, if the key is there."""
        section = node.child(key)
        if section is not None and not isinstance(section.value, dict):
            message = f"'{key}' wants keys and values, not {shown(section.value)}"
            self._stop(message, section.anchor)
        return section

    def _check_item(self, item: Node) -> None:
        wrong = [key for key in item.mapping if key not in USE_KEYS]
        for key in wrong:
            child = item.mapping[key]
            self._note(unknown_name("key", clipped(key), USE_KEYS), child.key or child.place)
        if wrong:
            raise _Unusable

    def _check_stack(self, stack: Node) -> None:
        wrong = [key for key in stack.mapping if key not in STACK_KEYS]
        if wrong:
            child = stack.mapping[wrong[0]]
            self._stop(
                f"a stack has no {clipped(', '.join(wrong))}: it has parameters, tasks and limits, "
                "and what else a run needs stands in the configuration",
                child.key or child.place,
            )

    def _take(self, node: Node, size: int) -> None:
        self._room -= size
        if self._room < 0:
            message = f"with its stacks a configuration has at most {MOST_VALUES} values"
            self._stop(message, node.place)

    def _note(self, message: str, place: Place) -> None:
        self.mistakes.append(Mistake((), message, place=place))

    def _stop(self, message: str, place: Place) -> NoReturn:
        self._note(message, place)
        raise _Unusable


def _size(node: Node) -> int:
    """Return the number of values in a node."""
    if isinstance(node.value, dict):
        return 1 + sum(1 + _size(child) for child in node.value.values())
    if isinstance(node.value, list):
        return 1 + sum(_size(item) for item in node.value)
    return 1
