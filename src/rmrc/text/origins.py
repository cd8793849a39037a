"""A resolved configuration as YAML, each value with its origin in a comment."""

import json
import re
from collections.abc import Iterator
from typing import Any

from rmrc.errors import printable
from rmrc.text.document import Document, Location
from rmrc.text.read import scalar

_UNQUOTED = re.compile(r"[A-Za-z_./][A-Za-z0-9_./-]*")
_WIDEST = 60  # columns before the comments


def annotated(values: dict[str, Any], document: Document) -> str:
    """Return values as YAML that loads back to them, each line with where it was written.

    Args:
        values: Every value of a configuration, defaults included.
        document: Where those that were written stand.
    """
    lines = [(text, _origin(document, at)) for text, at in _mapping(values, (), "")]
    width = min(_WIDEST, max(len(text) for text, _ in lines))
    return "".join(
        f"{text:<{width}}  # {origin}\n" if origin else f"{text}\n" for text, origin in lines
    )


def _origin(document: Document, location: Location | None) -> str:
    if location is None:
        return ""
    node = document.find(location)
    if node is None:
        return "default"
    items = node.value if isinstance(node.value, list) else []
    places = [node.place, *(item.place for item in items if item.place.file != node.place.file)]
    return printable(", ".join(dict.fromkeys(map(str, places))))


def _mapping(
    values: dict[str, Any], at: Location, indent: str
) -> Iterator[tuple[str, Location | None]]:
    for key, value in values.items():
        yield from _entry(f"{indent}{_text(key)}:", value, (*at, key), indent)


def _entry(
    head: str, value: Any, at: Location, indent: str
) -> Iterator[tuple[str, Location | None]]:
    if not value or not _is_block(value):
        yield f"{head} {_flow(value)}", at
        return
    yield head, None
    inner = f"{indent}  "
    if isinstance(value, dict):
        yield from _mapping(value, at, inner)
        return
    for index, item in enumerate(value):
        lines = _mapping(item, (*at, index), f"{inner}  ")
        first, location = next(lines)
        yield f"{inner}- {first.strip()}", location
        yield from lines


def _is_block(value: Any) -> bool:
    """Tell whether a value goes over several lines: a mapping, or a list of mappings."""
    return isinstance(value, dict) or (isinstance(value, list) and isinstance(value[0], dict))


def _flow(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_flow, value))}]"
    return _text(value) if isinstance(value, str) else json.dumps(value)


def _text(text: str) -> str:
    """Return text as YAML, in quotes where it needs them."""
    if _UNQUOTED.fullmatch(text) and scalar(text) == text:
        return text
    return printable(json.dumps(text, ensure_ascii=False))
