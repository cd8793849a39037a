"""What rmrc raises: one base class, one subclass for each thing that can be wrong."""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rmrc.text.mistakes import Mistake

MOST_COMPARED = 200
"""Known names that a wrong one is compared with: alike names take difflib a millisecond each."""


INTERRUPTED = 130
"""Exit code of what is interrupted before there is anything to save, as a shell has it."""


class RmrcError(Exception):
    """Base of everything that rmrc raises on purpose; its message is safe to print."""

    def __init__(self, message: str = ""):
        super().__init__(printable_lines(message))


class ConfigError(RmrcError):
    """A configuration is wrong; the message lists every mistake with its place."""

    mistakes: "tuple[Mistake, ...]" = ()
    """The same, one by one."""


class ModelError(RmrcError):
    """A name or a feature that the MuJoCo model, or the problem, does not have."""


class SolverError(RmrcError):
    """A QP backend cannot be set up as asked."""


def printable(text: str) -> str:
    """Return text with characters that a terminal or a browser would obey written out."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def printable_lines(text: str) -> str:
    """Return the same of each line of a text."""
    return "\n".join(map(printable, text.split("\n")))


def suggestion(wrong: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest known name, or an empty string."""
    names = [name for name in islice(known, MOST_COMPARED) if name]
    close = get_close_matches(wrong, names, n=1, cutoff=0.6)
    return f"; did you mean '{close[0]}'?" if close else ""


def unknown_name(kind: str, wrong: str, known: Iterable[str], limit: int = 12) -> str:
    """Return the message for a name that does not exist, with those that do."""
    names = [name for name in known if name]
    return (
        f"no {kind} named '{wrong}'{instead(wrong, names, limit) or f'; there is no {kind} at all'}"
    )


def instead(wrong: str, known: Sequence[str], limit: int = 12) -> str:
    """Return the end of a message on a wrong name: the nearest one, and those that there are."""
    close = suggestion(wrong, known)
    shown = ", ".join(known[:limit]) + (", …" if len(known) > limit else "")
    return f"{close} There is: {shown}" if close else f"; there is: {shown}" if known else ""
