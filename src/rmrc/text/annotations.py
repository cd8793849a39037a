"""The models' annotations, walked alongside data: which type is meant, which keys there are."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic.json_schema import SkipJsonSchema

NameKind = Literal[
    "site",
    "body",
    "geom",
    "joint",
    "keyframe",
    "equality",
    "geom or body",
    "mocap body",
    "site or body or geom",
]


@dataclass(frozen=True)
class NameOf:
    """Marks a string of the configuration as the name of something in the MuJoCo model."""

    kind: NameKind


_PYTHONS: Any = SkipJsonSchema
"""Marks what no file can say."""


def bare(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type and what `Annotated` says about it."""
    if get_origin(annotation) is Annotated:
        kind, *metadata = get_args(annotation)
        return kind, tuple(metadata)
    return annotation, ()


def is_model(annotation: Any) -> bool:
    """Tell whether a type is a model of the configuration."""
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


@cache
def members(annotation: Any) -> tuple[Any, ...]:
    """Return what a union is of but None and what no file can say; of anything else, nothing."""
    kind, _ = bare(annotation)
    if get_origin(kind) not in (Union, UnionType):
        return ()
    return tuple(
        member
        for member in get_args(kind)
        if member is not NoneType
        and not any(isinstance(item, _PYTHONS) for item in bare(member)[1])
    )


def optional(annotation: Any) -> Any:
    """Return T of ``T | None``, and any other annotation as it is."""
    inner = members(annotation)
    return inner[0] if len(inner) == 1 else annotation


def tag_key(annotation: Any) -> str | None:
    """Return the key that tells the members of a union apart, if there is one."""
    _, metadata = bare(annotation)
    tags = (item.discriminator for item in metadata if isinstance(item, FieldInfo))
    return next((tag for tag in tags if isinstance(tag, str)), None)


def tagged(annotation: Any) -> dict[str, Any]:
    """Return the members of a union by their tags."""
    key = tag_key(annotation)
    if key is None:
        return {}
    return {tag: member for member in members(annotation) for tag in get_args(hints(member)[key])}


@cache
def hints(model: Any) -> dict[str, Any]:
    """Return the annotations of a model's fields by the keys that a file has for them."""
    found = get_type_hints(model, include_extras=True)
    return {
        field.serialization_alias or name: found[name] for name, field in model.model_fields.items()
    }


@cache
def extra_hints(model: Any) -> tuple[Any, Any] | None:
    """Return the annotations of key and value of a model's other keys, if it takes any."""
    if model.model_config.get("extra") != "allow":
        return None
    key, value = get_args(get_type_hints(model, include_extras=True)["__pydantic_extra__"])
    return key, value


def descriptions(model: Any) -> dict[str, str]:
    """Return what a model says about its keys."""
    return {
        field.serialization_alias or name: field.description or ""
        for name, field in model.model_fields.items()
    }


def inside(annotation: Any, step: str | int) -> tuple[Any, Any] | None:
    """Return the annotations of the key (None where it is fixed) and the value at a step."""
    kind, _ = bare(annotation)
    if is_model(kind):
        if step in hints(kind):
            return None, hints(kind)[str(step)]
        return extra_hints(kind)
    arguments = get_args(kind)
    if get_origin(kind) is dict:
        return arguments
    if get_origin(kind) is tuple and isinstance(step, int):
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return None, arguments[0]
        return (None, arguments[step]) if step < len(arguments) else None
    return None


def entries(value: Any) -> Iterator[tuple[str | int, Any]]:
    """Yield the keys and values of a mapping, or the positions and items of a list."""
    if isinstance(value, dict):
        yield from value.items()
    elif isinstance(value, (list, tuple)):
        yield from enumerate(value)


def choose(annotation: Any, value: Any) -> Any | None:
    """Return the member of a union that a value is meant for, or None where it is like none.

    The union is told apart by its tag where it has one, else by the value's shape: a mapping is
    meant for a model, a text for a name or a literal, and so on.
    """
    tag = tag_key(annotation)
    if tag is not None:
        said = value.get(tag) if isinstance(value, dict) else getattr(value, tag, None)
        return tagged(annotation).get(said) if isinstance(said, str) else None
    fitting = [member for member in members(annotation) if _shape(value) in _shapes(member)]
    fitting.sort(key=lambda member: _preference(member, value))
    return fitting[0] if fitting else None


def _preference(member: Any, value: Any) -> int:
    kind, _ = bare(member)
    if get_origin(kind) is Literal:
        return 0 if value in get_args(kind) else 2
    return 0 if is_model(kind) and isinstance(value, kind) else 1


def _shape(value: Any) -> str:
    match value:
        case bool():
            return "bool"
        case int() | float():
            return "number"
        case str():
            return "text"
        case dict() | BaseModel():
            return "mapping"
        case list() | tuple():
            return "list"
        case np.ndarray() | np.generic():
            return _shape(value.tolist())
    return ""


def _shapes(annotation: Any) -> set[str]:
    kind, _ = bare(annotation)
    if get_origin(kind) in (Union, UnionType):
        return {shape for member in get_args(kind) for shape in _shapes(member)}
    if is_model(kind) or get_origin(kind) is dict:
        return {"mapping"}
    if get_origin(kind) is tuple:
        return {"list"}
    if get_origin(kind) is Literal or kind is str:
        return {"text"}
    return {"number"} if kind in (int, float) else set()


def described(annotation: Any) -> str:
    """Return what an annotation wants, as the object of a sentence."""
    return _alternatives(list(dict.fromkeys(_wanted(annotation))))


def _alternatives(names: list[str]) -> str:
    return " or ".join([", ".join(names[:-1]), names[-1]]) if names[1:] else names[0]


def _wanted(annotation: Any) -> Iterator[str]:
    """Yield what an annotation wants, each member of a union on its own."""
    kind, metadata = bare(annotation)
    name = next((item.kind for item in metadata if isinstance(item, NameOf)), None)
    if name is not None:
        yield f"the name of a {name}"
    elif (tag := tag_key(annotation)) is not None:
        yield f"a mapping with {tag}"
    elif members(annotation):
        for member in members(annotation):
            yield from _wanted(member)
    elif get_origin(kind) is Literal:
        yield from (f"'{value}'" for value in get_args(kind))
    elif get_origin(kind) is tuple:
        yield _wanted_list(get_args(kind))
    elif is_model(kind):
        keys = [*hints(kind), *(["names of joints"] if extra_hints(kind) else [])]
        yield "a mapping" + (f" with {_alternatives(keys)}" if len(keys) < 6 else "")
    elif get_origin(kind) is dict:
        yield "a mapping"
    else:
        yield {
            float: "a number",
            int: "a whole number",
            str: "text",
            bool: "true or false",
        }.get(kind, "another value")


def _wanted_list(arguments: tuple[Any, ...]) -> str:
    item, *others = arguments
    kind, _ = bare(item)
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        return "a list of pairs" if len(inner) == 2 and Ellipsis not in inner else "a matrix"
    count = "" if others == [Ellipsis] else f"{1 + len(others)} "
    if is_model(kind) or tag_key(item):
        return f"a list of {count}mappings"
    plural = {"a number": "numbers", "the name of a joint": "names of joints"}
    return f"a list of {count}{plural.get(described(item), 'values')}"
