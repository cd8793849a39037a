"""XML with the line of each element, and numbers that are checked where they stand."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from rmrc.errors import ModelError

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_TAG = re.compile(rb"<([A-Za-z_][\w:.-]*)")
_DECLARATION = re.compile(rb"<\?xml\s[^>]*\?>")


class Located(ElementTree.Element):
    """An element that knows its line."""

    line: int = 0


def parse(text: str | bytes, name: str) -> Located:
    """Return the root of a XML text.

    Args:
        text: The text.
        name: How messages call the file.

    Raises:
        ModelError: If it is not XML.
    """
    parser = expat.ParserCreate()
    builder = ElementTree.TreeBuilder(element_factory=Located)

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = builder.start(tag, attributes)
        assert isinstance(element, Located)
        element.line = parser.CurrentLineNumber

    parser.StartElementHandler, parser.EndElementHandler = start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        raw = text.encode() if isinstance(text, str) else text
        # Files of some simulators say version 0.0, or say it below a comment; all are UTF-8.
        parser.Parse(_DECLARATION.sub(b"", raw), True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise ModelError(f"{name}:{error.lineno}: this is not XML: {reason}") from None
    root = builder.close()
    assert isinstance(root, Located)
    return root


def numbers(
    element: Located | None, key: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    """Return the numbers of an attribute, as many as its default has.

    Raises:
        ModelError: If they are not that many finite numbers; the message says where.
    """
    text = None if element is None else element.get(key)
    if element is None or text is None:
        return default
    try:
        values = tuple(map(float, text.split()))
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(map(math.isfinite, values)):
        wanted = "a number" if len(default) == 1 else f"{len(default)} numbers"
        raise ModelError(
            f'{where.format(line=element.line)}: {key}="{text}" of <{element.tag}> '
            f"is to be {wanted}"
        )
    return values


def first(element: ElementTree.Element, path: str) -> Located | None:
    """Return the first element below that has a path."""
    found = element.find(path)
    return found if isinstance(found, Located) else None


def root_tag(path: Path) -> str:
    """Return the tag of a file's root element, or an empty text where it has none."""
    text = _COMMENT.sub(b"", path.read_bytes())
    found = _TAG.search(text)
    return found[1].decode() if found else ""
