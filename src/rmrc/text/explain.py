"""pydantic's errors to our mistakes: clean locations, one sentence for each, in plain words."""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from rmrc.errors import instead, suggestion, unknown_name
from rmrc.text.annotations import (
    bare,
    choose,
    described,
    descriptions,
    hints,
    inside,
    is_model,
    members,
    optional,
    tag_key,
    tagged,
)
from rmrc.text.document import Location
from rmrc.text.mistakes import MOST_MISTAKES, Disagreement, Mistake, clipped, shown

_KEY = "[key]"
"""What pydantic appends to a location where a mapping's key is wrong, not its value."""


def explain(annotation: Any, value: Any, error: ValidationError) -> list[Mistake]:
    """Return what is wrong with a value, as far as a reader wants to know at once.

    Args:
        annotation: The type that the value was validated against.
        value: The value, before validation.
        error: What pydantic found.
    """
    found = _explained(annotation, value, error, ())
    return list(islice(_distinct(found), MOST_MISTAKES + 1))


def _distinct(mistakes: Iterator[Mistake]) -> Iterator[Mistake]:
    seen: set[Mistake] = set()
    for mistake in mistakes:
        if mistake not in seen:
            seen.add(mistake)
            yield mistake


def _explained(
    annotation: Any, value: Any, error: ValidationError, base: Location
) -> Iterator[Mistake]:
    unions: set[Location] = set()
    for details in error.errors(include_url=False):
        fault = _Fault(annotation, value, base, details)
        if not fault.in_union:
            yield from fault.mistakes()
        elif fault.location not in unions:
            unions.add(fault.location)
            yield from _explained_union(fault.annotation, fault.value, fault.location)


def _explained_union(annotation: Any, value: Any, location: Location) -> Iterator[Mistake]:
    """Explain a value by the one member of a union that it looks like.

    pydantic says what each of the members has against it, several answers to one mistake; so the
    value is validated again, against that member alone.
    """
    member = choose(annotation, value)
    literals = [str(v) for m in members(annotation) for v in _literals(m)]
    if member is not None and not _literals(member):
        try:
            TypeAdapter(member).validate_python(value)
        except ValidationError as error:
            yield from _explained(member, value, error, location)
            return
    close = suggestion(clipped(value), literals) if isinstance(value, str) else ""
    yield Mistake(location, f"{described(annotation)} is wanted here, not {shown(value)}{close}")


def _literals(annotation: Any) -> tuple[Any, ...]:
    kind, _ = bare(annotation)
    return get_args(kind) if get_origin(kind) is Literal else ()


class _Fault:
    """One of pydantic's errors, followed down to the value that it is about."""

    def __init__(self, annotation: Any, value: Any, base: Location, details: ErrorDetails):
        self.annotation, self.value, self.location = optional(annotation), value, base
        self.model: Any = None
        self.kind = details["type"]
        self.context: dict[str, Any] = details.get("ctx", {})
        self._message = details["msg"]
        self.in_union = self.at_key = False
        steps = list(details["loc"])
        while steps and not self.in_union:
            self._follow(steps)
        if not self.in_union:
            self.value = details["input"]

    def _follow(self, steps: list[str | int]) -> None:
        """Take the next of pydantic's steps, which may be a tag or a member's label."""
        if steps == [_KEY]:
            self.at_key = True
            steps.clear()
        elif tags := tagged(self.annotation):
            self.annotation = tags.get(str(steps.pop(0)))
        elif members(self.annotation):
            self.in_union = True
        elif self.kind == "missing" and isinstance(steps[-1], int) and len(steps) == 1:
            self.model = None  # a list that is too short is wrong as a whole
            steps.clear()
        else:
            self._descend(steps.pop(0))

    def _descend(self, step: str | int) -> None:
        below = inside(self.annotation, step)
        self.model = self.annotation if is_model(self.annotation) else None
        self.annotation = optional(below[1]) if below else None
        self.location = (*self.location, step)
        try:
            self.value = self.value[step]
        except (TypeError, LookupError):  # a model, or a key that is missing
            self.value = getattr(self.value, str(step), None)

    def mistakes(self) -> Iterator[Mistake]:
        """Yield what to say; a configuration's own validator may have found several mistakes."""
        cause = self.context.get("error")
        if isinstance(cause, Disagreement):
            yield from cause.mistakes
            return
        if self.kind == "too_short" and _count(self.value) >= self.context["min_length"]:
            return  # pydantic does not count the items that are wrong themselves
        location, at_key = self.location, self.at_key or self.kind == "extra_forbidden"
        if self.kind == "union_tag_invalid":
            location = (*location, tag_key(self.annotation) or "")
        yield Mistake(location, self.sentence, at_key)

    @property
    def sentence(self) -> str:
        """What is wrong, in a sentence."""
        say = _SENTENCES.get(self.kind)
        if say is not None:
            return say(self)
        if self.kind.endswith("_type") and self.annotation is not None:
            return f"{described(self.annotation)} is wanted here, not {shown(self.value)}"
        return self._message

    @property
    def last(self) -> str:
        """The last key of the location."""
        return str(self.location[-1]) if self.location else ""


def _missing(fault: _Fault) -> str:
    if fault.model is None:
        return _wrong_length(fault)
    says = " ".join(descriptions(fault.model).get(fault.last, "").split()).rstrip(".")
    if says[1:2].islower() or says[1:2] == " ":
        says = says[0].lower() + says[1:]
    return f"the key '{fault.last}' is missing" + (f": {says}" if says else "")


def _wrong_length(fault: _Fault) -> str:
    wanted = described(fault.annotation)
    return f"{wanted} is wanted here, and this one has {_count(fault.value)}"


def _count(value: Any) -> int:
    return len(value) if isinstance(value, (list, tuple)) else 0


def _length(fault: _Fault) -> str:
    if not fault.value:
        return "this list is empty; name at least one"
    return _wrong_length(fault)


def _unknown_tag(fault: _Fault) -> str:
    tag = tag_key(fault.annotation) or ""
    value = fault.value.get(tag) if isinstance(fault.value, dict) else None
    return _not_one_of(tag, value, tagged(fault.annotation))


def _no_tag(fault: _Fault) -> str:
    known = ", ".join(tagged(fault.annotation))
    return f"the key '{tag_key(fault.annotation)}' is missing: it is one of {known}"


def _not_one_of(key: str, value: Any, known: Iterable[Any]) -> str:
    said = clipped(value) if isinstance(value, str) else ""
    quoted = f"'{said}'" if said else shown(value)
    return f"'{key}' cannot be {quoted}{instead(said, [str(name) for name in known], limit=20)}"


def _unknown_key(fault: _Fault) -> str:
    return unknown_name("key", clipped(fault.last), hints(fault.model), limit=20)


def _bound(words: str, name: str) -> "_Sentence":
    return lambda fault: f"this must be {words} {fault.context[name]:g}, not {shown(fault.value)}"


_Sentence = Callable[[_Fault], str]
# What to say of pydantic's error types; of others whose names end in _type, what is wanted instead.
_SENTENCES: dict[str, _Sentence] = {
    "missing": _missing,
    "extra_forbidden": _unknown_key,
    "literal_error": lambda fault: _not_one_of(
        fault.last, fault.value, _literals(fault.annotation)
    ),
    "union_tag_invalid": _unknown_tag,
    "union_tag_not_found": _no_tag,
    "too_short": _length,
    "too_long": _length,
    "greater_than": _bound("greater than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("less than", "lt"),
    "less_than_equal": _bound("at most", "le"),
    "finite_number": lambda fault: f"a number must be finite, and this is {shown(fault.value)}",
    "string_pattern_mismatch": lambda fault: (
        f"'{clipped(fault.last if fault.at_key else str(fault.value))}' is no name: a name is of "
        "letters, digits, _ and -, and begins with a letter or _"
    ),
    "value_error": lambda fault: str(fault.context["error"]),
}
