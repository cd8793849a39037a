"""What rmrc raises: one base class, one subclass for each thing that can be wrong."""

from collections.abc import Iterable
from difflib import get_close_matches


class RmrcError(Exception):
    """Base of everything that rmrc raises on purpose."""


class ConfigError(RmrcError):
    """A configuration is wrong; the message lists every mistake with its place."""


class ModelError(RmrcError):
    """A name or a feature that the MuJoCo model, or the problem, does not have."""


class SolverError(RmrcError):
    """A QP backend cannot be set up as asked."""


def suggestion(wrong: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest known name, or an empty string."""
    close = get_close_matches(wrong, [name for name in known if name], n=1, cutoff=0.6)
    return f"; did you mean '{close[0]}'?" if close else ""


def unknown_name(kind: str, wrong: str, known: Iterable[str], limit: int = 12) -> str:
    """Return the message for a name that does not exist, with those that do."""
    names = [name for name in known if name]
    shown = ", ".join(names[:limit]) + (", …" if len(names) > limit else "")
    have = f"; there is: {shown}" if names else f"; there is no {kind} at all"
    return f"no {kind} named '{wrong}'{suggestion(wrong, names)}{have}"
