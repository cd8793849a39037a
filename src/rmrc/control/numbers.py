"""Numbers that come in at run time, whatever they are."""

SHORTEST, LONGEST = 1e-9, 1e3
"""Lengths of a step in s beyond which a clock, not a robot, is at fault."""


def seconds_of(dt: object) -> float | None:
    """Return a length of a step in s, or None if it is none."""
    seconds = number(dt)
    return seconds if seconds is not None and SHORTEST <= seconds <= LONGEST else None


def number(value: object) -> float | None:
    """Return a number as a float; None for what is none, a text of digits included."""
    if isinstance(value, (str, bytes)):
        return None
    try:
        return float(value)  # type: ignore[arg-type]
    except Exception:  # a `__float__` of others raises what it likes
        return None


def told(value: object) -> str:
    """Return a value as a message shows it."""
    seconds = number(value)
    return f"a {type(value).__name__}" if seconds is None else f"{seconds:g}"
