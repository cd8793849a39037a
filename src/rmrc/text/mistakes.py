"""Mistakes in a configuration: each said in a sentence, with its place, the line and a caret."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from rmrc.errors import ConfigError, printable
from rmrc.text.document import NOWHERE, Location, Place

MOST_MISTAKES = 20
"""A message lists no more than these; nobody reads on."""
_WIDEST_LINE = 100
_LONGEST_VALUE = 60
_LONGEST_MESSAGE = 2000


@dataclass(frozen=True)
class Mistake:
    """One thing that is wrong, and where."""

    location: Location
    message: str
    key: bool = False
    """Whether the key is wrong, not its value."""
    other: Location | None = None
    """A second place that the mistake is about."""
    place: Place | None = None
    """Where it is, if that is known without the document."""


class Disagreement(ValueError):
    """Mistakes that the validator of a whole configuration found."""

    def __init__(self, mistakes: Iterable[Mistake]):
        self.mistakes = tuple(mistakes)
        super().__init__("; ".join(mistake.message for mistake in self.mistakes))


class Placed(Protocol):
    """What knows the places of values: a `Document` or a `Config`."""

    def place(self, location: Location, key: bool = False) -> Place | None:
        """Return the place of a value or of its key, if it has one."""
        ...


def config_error(mistakes: Iterable[Mistake], source: Placed = NOWHERE) -> ConfigError:
    """Return the error that lists mistakes in the order of their places.

    Args:
        mistakes: At least one; their locations are those of the resolved configuration.
        source: Where the values come from. Without a place a mistake names its location.
    """
    placed = [_placed(mistake, source) for mistake in dict.fromkeys(mistakes)]
    main = source.place(())
    placed.sort(key=lambda mistake: _order(mistake.place, main))
    lines = [_formatted(mistake) for mistake in placed[:MOST_MISTAKES]]
    if len(placed) > MOST_MISTAKES:
        lines.append("… and more mistakes; these are the first")
    error = ConfigError("\n".join(lines))
    error.mistakes = tuple(placed)
    return error


def _placed(mistake: Mistake, source: Placed) -> Mistake:
    message = mistake.message
    if mistake.other is not None:
        other = source.place(mistake.other)
        message += f"; the other is at {other or dotted(mistake.other)}"
        message += f", used at {other.use}" if other and other.use else ""
    place = mistake.place or source.place(mistake.location, mistake.key)
    return replace(mistake, message=message, other=None, place=place)


def _order(place: Place | None, main: Place | None) -> tuple[bool, bool, str, int, int]:
    """What was said on the command line comes first, then the main file, then its stacks."""
    if place is None:
        return (False, False, "", 0, 0)
    stack = main is None or place.file != main.file
    return (place.line > 0, stack, place.file, place.line, place.column)


def _formatted(mistake: Mistake) -> str:
    place = mistake.place
    message = printable(clipped(mistake.message, _LONGEST_MESSAGE))
    if place is None:
        return f"{dotted(mistake.location)}: {message}" if mistake.location else message
    if not place.line:
        return f"{printable(place.file)}: {message}"
    where = f"{printable(place.file)}:{place.line}:{place.column}"
    use = f"\n    used at {printable(str(place.use))}" if place.use else ""
    return f"{where}: {message}{_with_caret(place)}{use}"


def _with_caret(place: Place) -> str:
    """Return the line and a caret below the column, cut out of a very long line."""
    begin = max(0, place.column - _WIDEST_LINE // 2) if len(place.text) > _WIDEST_LINE else 0
    text = place.text[begin : begin + _WIDEST_LINE]
    column = place.column - 1 - begin
    before = printable(text[:column].expandtabs(4))
    after = printable(text[column:].expandtabs(4))
    return f"\n    {before}{after.rstrip()}\n    {' ' * len(before)}^"


def dotted(location: Location) -> str:
    """Return a location as `tasks[2].B`; as an option of the command line takes it."""
    text = ""
    for step in location:
        text += f"[{step}]" if isinstance(step, int) else f".{printable(step)}"
    return text.removeprefix(".")


def shown(value: Any) -> str:
    """Return what kind of value this is, and the value itself if it is short."""
    match value:
        case None:
            return "an empty value"
        case bool():
            return "true" if value else "false"
        case int() | float():
            return clipped(str(value))
        case str():
            return f"the text '{clipped(value)}'" if value else "an empty text"
        case dict():
            return "a mapping"
        case list() | tuple():
            return "a list" if value else "an empty list"
    return f"a value of type {type(value).__name__}"


def clipped(text: str, longest: int = _LONGEST_VALUE) -> str:
    """Return text, cut where it is too long for a message."""
    return text if len(text) <= longest else f"{text[:longest]}…"
