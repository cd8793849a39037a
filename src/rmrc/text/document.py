"""What a configuration says and where it says it: a tree of values, each with its place."""

from dataclasses import dataclass
from typing import Any

Location = tuple[str | int, ...]
"""Keys and list positions that lead from the root to a value."""


@dataclass(frozen=True, slots=True)
class Place:
    """A point in a file; a whole file or an option where `line` is 0."""

    file: str
    line: int = 0
    column: int = 0
    text: str = ""
    """The line itself."""
    use: "Place | None" = None
    """Where the configuration uses the stack that this is in."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


@dataclass(frozen=True, slots=True)
class Node:
    """A value and its place: a scalar, a list of nodes or a dict of nodes."""

    value: Any
    place: Place
    key: Place | None = None
    """Where the key is that holds the value."""

    @property
    def mapping(self) -> dict[str, "Node"]:
        """The entries of a mapping; of anything else, none."""
        return self.value if isinstance(self.value, dict) else {}

    @property
    def plain(self) -> Any:
        """The value without places."""
        if isinstance(self.value, dict):
            return {key: child.plain for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain for child in self.value]
        return self.value

    @property
    def anchor(self) -> Place:
        """Where a reader looks for the value: at its key if the value begins on a later line."""
        key = self.key
        below = key is not None and key.file == self.place.file and key.line < self.place.line
        return key if key is not None and below else self.place

    def child(self, step: str | int) -> "Node | None":
        """Return the entry of a mapping or the item of a list, if there is one."""
        if isinstance(self.value, dict) and isinstance(step, str):
            return self.value.get(step)
        if isinstance(self.value, list) and isinstance(step, int) and step < len(self.value):
            return self.value[step]
        return None


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """The tree of one configuration, stacks and overrides included; without a root, of none."""

    root: Node | None = None

    def __eq__(self, other: object) -> bool:
        """Hold for any two documents: a `Config` is what it says, not where it says it."""
        return isinstance(other, Document)

    __hash__ = object.__hash__

    def find(self, location: Location) -> Node | None:
        """Return the node at a location, if it was written."""
        node = self.root
        for step in location:
            node = node.child(step) if node is not None else None
        return node

    def place(self, location: Location, key: bool = False) -> Place | None:
        """Return the place of a value, or of its key, or of the mapping that lacks it."""
        node = self.root
        if node is None:
            return None
        for step in location:
            child = node.child(step)
            if child is None:
                return node.anchor
            node = child
        return node.key if key and node.key is not None else node.anchor


NOWHERE = Document()
"""The document of a configuration that was built in Python."""
