"""Reading YAML 1.2 with positions; size, depth and aliases are bounded, and nothing is executed."""

import errno
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.reader import ReaderError
from ruamel.yaml.scanner import Scanner, ScannerError

from rmrc.errors import ConfigError, suggestion
from rmrc.text.document import Node, Place
from rmrc.text.mistakes import MOST_MISTAKES, Mistake, clipped, config_error

# Within these a file is read, and refused, in less than a second.
LARGEST_FILE = 500_000  # bytes
MOST_VALUES = 20_000
DEEPEST = 50
LONGEST_TEXT = 10_000  # characters of one text; no path and no name is longer

# The core schema of YAML 1.2, section 10.3.2.
_NULL = re.compile(r"~|null|Null|NULL|")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]{1,20}|0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")

# What ruamel says of a text that is no YAML, and what we say.
_SYNTAX = {
    "tag": "tags such as !!python/object have no meaning here; remove it",
    "directive": "a line cannot begin with %; directives of YAML have no meaning here",
    "could not find expected ':'": "a key has a colon and a space after it: write 'key: value'",
    "mapping values are not allowed here": "a colon cannot stand here: a key begins its own line, "
    "and text with ': ' in it goes into quotes",
    "'\\t' that cannot start any token": "a tab cannot stand here: indent with spaces",
    "that cannot start any token": "text that begins with @, ` or % goes into quotes",
    "expected <block end>": "this does not line up with what stands above it: keys of one mapping, "
    "and the items of one list, begin in the same column",
    "expected ',' or ']'": "this list is missing a comma or its closing ]; "
    "text with { } [ ] in it goes into quotes",
    "expected ',' or '}'": "this mapping is missing a comma or its closing }; "
    "text with { } [ ] in it goes into quotes, as '${name}' does",
    "found unexpected end of stream": "the text in quotes that begins here never ends",
    "expected the node content": "a value is missing here",
    "sequence entries are not allowed here": "a list cannot begin here: put '- ' on its own line",
    "found unknown escape character": "inside double quotes a backslash begins an escape: write "
    "\\\\ for a backslash, or use single quotes",
}


class _Scanner(Scanner):
    """Stops at what a configuration has no use for, before any work goes into it."""

    def fetch_tag(self) -> None:
        raise ScannerError(None, None, "tag", self.reader.get_mark())

    def fetch_directive(self) -> None:
        raise ScannerError(None, None, "directive", self.reader.get_mark())


def read(path: Path, name: str) -> Node:
    """Return the tree of a YAML file, a mapping.

    Args:
        path: The file.
        name: How messages call it.

    Raises:
        ConfigError: If it cannot be read or is no YAML mapping.
    """
    whole = Place(name)
    node = parse(_text(path, whole), name)
    if node is None or node.value is None:
        raise _error("the file is empty", whole)
    if not isinstance(node.value, dict):
        raise _error("the file must hold keys and values, as in 'scene: panda.xml'", node.place)
    return node


def parse(text: str, name: str) -> Node | None:
    """Return the tree of a YAML text, or None where it holds no value.

    Raises:
        ConfigError: If it is no YAML, or beyond the bounds.
    """
    composer = _Composer(text, name)
    try:
        node = composer.document()
    except MarkedYAMLError as error:
        raise composer.syntax_error(error) from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise _error(
            f"line {line} has the character {text[error.position]!r}, which no text file has",
            Place(name),
        ) from None
    except YAMLError as error:
        raise _error(f"this is not YAML: {' '.join(str(error).split())}", Place(name)) from None
    if composer.mistakes:
        raise config_error(composer.mistakes)
    return node


def _text(path: Path, whole: Place) -> str:
    try:
        if path.is_dir():
            raise _error("this is a folder, not a file", whole)
        if path.exists() and not path.is_file():
            raise _error("this is not a regular file", whole)
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise _error(_why_unreadable(path, error), whole) from None
    if len(content) > LARGEST_FILE:
        raise _error(
            f"a configuration has at most {LARGEST_FILE // 1000} kB, and this file has more; "
            "tables of poses go into a path of type file (.csv or .npz)",
            whole,
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise _error(f"this is not a text file in UTF-8: see line {line}", whole) from None
    if "\0" in text:
        raise _error("this is a binary file, not text", whole)
    return text


def _why_unreadable(path: Path, error: OSError | ValueError) -> str:
    if isinstance(error, FileNotFoundError):
        found = path.parent.glob("*.y*ml") if path.parent.is_dir() else ()
        return f"there is no such file{suggestion(path.name, sorted(p.name for p in found))}"
    if isinstance(error, PermissionError):
        return "you have no permission to read this file"
    if isinstance(error, OSError) and error.errno == errno.ELOOP:
        return "this is a symbolic link that leads back to itself"
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"the file cannot be read: {reason}"


def _error(message: str, place: Place) -> ConfigError:
    return config_error([Mistake((), message, place=place)])


class _Composer:
    """Builds the tree from ruamel's events, counting as it goes."""

    def __init__(self, text: str, name: str):
        self.mistakes: list[Mistake] = []
        self._name = name
        self._lines = text.splitlines()
        yaml = YAML(typ="safe", pure=True)
        yaml.Scanner = _Scanner
        self._events: Iterator[Any] = yaml.parse(text)
        self._count = 0
        self._anchors: dict[str, tuple[Node, int, int]] = {}
        self._open: set[str] = set()

    def document(self) -> Node | None:
        """Return the tree of the one document."""
        next(self._events)  # the stream's start
        if isinstance(next(self._events), events.StreamEndEvent):
            return None
        node, _ = self._node(next(self._events), 0)
        next(self._events)  # the document's end
        following = next(self._events)
        if not isinstance(following, events.StreamEndEvent):
            self._fail("a second document begins here; a file holds one", self._place(following))
        return node

    def syntax_error(self, error: MarkedYAMLError) -> ConfigError:
        """Say what ruamel found in words for someone who does not know how YAML is parsed."""
        problem = str(error.problem)
        said = next((ours for theirs, ours in _SYNTAX.items() if theirs in problem), None)
        # What never ends is noticed at the end, and is best pointed to where it begins.
        late = ("unexpected end of stream", "expected ','", "could not find expected ':'")
        begin = error.context_mark if any(part in problem for part in late) else None
        mark = begin or error.problem_mark
        place = self._at(mark.line, mark.column) if mark else Place(self._name)
        return _error(said or f"this is not YAML: {problem}", place)

    def _node(self, event: Any, depth: int, key: Place | None = None) -> tuple[Node, int]:
        """Return the node that an event begins, and how deep it is."""
        place = self._place(event)
        if isinstance(event, events.AliasEvent):
            return self._alias(event.anchor, place, depth, key)
        before = self._count
        self._counted(1, depth, place)
        if event.anchor:
            self._open.add(event.anchor)
        if isinstance(event, events.ScalarEvent):
            node, height = Node(self._scalar(event, place), place, key), 0
        elif isinstance(event, events.SequenceStartEvent):
            value, height = self._items(depth)
            node = Node(value, place, key)
        else:
            value, height = self._entries(depth)
            node = Node(value, place, key)
        if event.anchor:
            self._open.discard(event.anchor)
            self._anchors[event.anchor] = (node, self._count - before, height)
        return node, height

    def _items(self, depth: int) -> tuple[list[Node], int]:
        items, height = [], 0
        while not isinstance(event := next(self._events), events.SequenceEndEvent):
            node, below = self._node(event, depth + 1)
            items.append(node)
            height = max(height, below + 1)
        return items, height

    def _entries(self, depth: int) -> tuple[dict[str, Node], int]:
        entries: dict[str, Node] = {}
        height = 0
        while not isinstance(event := next(self._events), events.MappingEndEvent):
            place = self._place(event)
            key, _ = self._node(event, depth + 1)
            node, below = self._node(next(self._events), depth + 1, place)
            height = max(height, below + 1)
            if _is_merge(event):
                self._mistake("<< has no meaning here; a stack with parameters does this", place)
            elif not isinstance(key.value, str) or isinstance(event, events.AliasEvent):
                self._mistake("a key must be text; put it into quotes", place)
            elif key.value in entries:
                first = entries[key.value].key
                self._mistake(f"the key '{clipped(key.value)}' is here twice: see {first}", place)
            else:
                entries[key.value] = node
        return entries, height

    def _alias(self, anchor: str, place: Place, depth: int, key: Place | None) -> tuple[Node, int]:
        if anchor in self._open:
            self._fail(f"the alias *{clipped(anchor)} stands inside what it refers to", place)
        if anchor not in self._anchors:
            close = suggestion(clipped(anchor), self._anchors)
            self._fail(f"there is no anchor &{clipped(anchor)} above{close}", place)
        node, size, height = self._anchors[anchor]
        self._counted(size, depth + height, place)
        return Node(node.value, place, key), height

    def _scalar(self, event: Any, place: Place) -> Any:
        value = scalar(event.value) if event.implicit[0] else event.value
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            self._mistake(too_long(value), place)
        if isinstance(value, str) and ("\0" in value or (not value.isascii() and _torn(value))):
            self._mistake("this text has a character that no name or path can have", place)
        return value

    def _counted(self, size: int, depth: int, place: Place) -> None:
        self._count += size
        if self._count > MOST_VALUES:
            self._fail(
                f"a configuration has at most {MOST_VALUES} values, aliases counted as what they "
                "stand for; tables of poses go into a path of type file (.csv or .npz)",
                place,
            )
        if depth > DEEPEST:
            self._fail(f"a configuration is at most {DEEPEST} levels deep", place)

    def _place(self, event: Any) -> Place:
        return self._at(event.start_mark.line, event.start_mark.column)

    def _at(self, line: int, column: int) -> Place:
        text = self._lines[line] if line < len(self._lines) else ""
        return Place(self._name, line + 1, column + 1, text)

    def _mistake(self, message: str, place: Place) -> None:
        self.mistakes.append(Mistake((), message, place=place))
        if len(self.mistakes) > MOST_MISTAKES:
            raise config_error(self.mistakes)

    def _fail(self, message: str, place: Place) -> None:
        raise config_error([*self.mistakes, Mistake((), message, place=place)])


def _is_merge(event: Any) -> bool:
    """Tell whether a key is YAML 1.1's plain ``<<``."""
    return isinstance(event, events.ScalarEvent) and event.implicit[0] and event.value == "<<"


def _torn(text: str) -> bool:
    """Tell whether text has half of a surrogate pair, which cannot be written as UTF-8."""
    return any("\ud800" <= character <= "\udfff" for character in text)


def too_long(text: str) -> str:
    """Return what to say of a text that is longer than any name or path."""
    return f"a text has at most {LONGEST_TEXT} characters, and this one has {len(text)}"


def scalar(text: str) -> Any:
    """Return what a plain scalar stands for; an integer too long for 64 bits becomes a float."""
    if _NULL.fullmatch(text):
        return None
    if _TRUE.fullmatch(text):
        return True
    if _FALSE.fullmatch(text):
        return False
    if _BASED.fullmatch(text):
        return int(text, 0)
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) <= 18 else float(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if sign := _INFINITY.fullmatch(text):
        return float(f"{sign[1]}inf")
    return float("nan") if _NAN.fullmatch(text) else text
