"""The JSON Schema of configurations and stacks, for editors: one for both kinds of file."""

from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from rmrc.config.models import Config
from rmrc.limits.models import LimitsModel
from rmrc.tasks import Task
from rmrc.text.stacks import PARAMETER

Schema = dict[str, Any]

_IN_STACK = "InStack"
"""What the names of definitions end in where a parameter may stand for any value."""


def schema() -> Schema:
    """Return the JSON Schema (2020-12) of a configuration or, without a run's own keys, a stack."""
    config, definitions = _generated(Config)
    tasks = config["properties"]["tasks"]
    tasks["items"] = {
        "if": {"required": ["use"]},
        "then": {"$ref": "#/$defs/Use"},
        "else": tasks["items"],
    }
    stack, in_stacks = _stack()
    own = [key for key in config["properties"] if key not in stack["properties"]]
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        "title": "rmrc: a configuration, or a stack of tasks and limits",
        "if": {"anyOf": [{"required": [key]} for key in own]},
        "then": {"$ref": "#/$defs/Config"},
        "else": {"$ref": "#/$defs/Stack"},
        "$defs": {"Config": config, "Stack": stack, "Use": _USE, **definitions, **in_stacks},
    }


_USE = {
    "description": "A stack, whose tasks come here and whose limits join the configuration's.",
    "type": "object",
    "properties": {
        "use": {"description": "The stack's file, relative to this one.", "type": "string"},
        "with": {"description": "Values of the stack's parameters.", "type": "object"},
        "override": {
            "description": "Changes to the stack's tasks, by name, and to its limits.",
            "type": "object",
            "additionalProperties": {"type": "object"},
        },
    },
    "required": ["use"],
    "additionalProperties": False,
}

_PARAMETER = {
    "description": "A parameter of the stack: $name, or text with ${name} in it.",
    "type": "string",
    "pattern": r"\$",
}


def _stack() -> tuple[Schema, Schema]:
    """Return the schema of a stack and its definitions."""
    tasks, definitions = _generated(list[Task])
    limits, more = _generated(LimitsModel)
    stack = {
        "description": "A stack of tasks and limits, which a configuration takes in with `use`.",
        "type": "object",
        "properties": {
            "parameters": {
                "description": "Parameters and their defaults; one without a default is required.",
                "type": "object",
                "propertyNames": {"pattern": f"^{PARAMETER.pattern}$"},
            },
            "tasks": _open_to_parameters(tasks),
            "limits": _open_to_parameters(limits),
        },
        "additionalProperties": False,
    }
    named = {
        f"{name}{_IN_STACK}": _open_to_parameters(definition)
        for name, definition in {**definitions, **more}.items()
    }
    return stack, {"Parameter": _PARAMETER, **named}


class _Untitled(GenerateJsonSchema):
    """Leaves out the titles, which only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def _generated(kind: Any) -> tuple[Schema, Schema]:
    """Return pydantic's schema of a type and the definitions it refers to."""
    made = TypeAdapter(kind).json_schema(schema_generator=_Untitled)
    definitions = made.pop("$defs", {})
    return _told_apart(made), _told_apart(definitions)


def _told_apart(node: Any) -> Any:
    """Replace unions with a tag by conditions on it, so that an editor names one mistake."""
    if isinstance(node, list):
        return [_told_apart(item) for item in node]
    if not isinstance(node, dict):
        return node
    if "discriminator" not in node:
        return {key: _told_apart(value) for key, value in node.items()}
    tag, mapping = node["discriminator"]["propertyName"], node["discriminator"]["mapping"]
    return {
        "type": "object",
        "properties": {tag: {"enum": list(mapping)}},
        "required": [tag],
        "allOf": [
            {
                "if": {"properties": {tag: {"const": name}}, "required": [tag]},
                "then": {"$ref": reference},
            }
            for name, reference in mapping.items()
        ],
    }


def _open_to_parameters(node: Any) -> Any:
    """Allow a parameter wherever a schema wants a value."""
    if isinstance(node, list):
        return [_open_to_parameters(item) for item in node]
    if not isinstance(node, dict):
        return node
    opened = {}
    for key, value in node.items():
        if key == "$ref":
            opened[key] = f"{value}{_IN_STACK}"
        elif key == "properties":
            opened[key] = {name: _or_parameter(item) for name, item in value.items()}
        elif key in ("items", "additionalProperties") and isinstance(value, dict):
            opened[key] = _or_parameter(value)
        elif key in ("anyOf", "allOf", "if", "then", "prefixItems"):
            opened[key] = _open_to_parameters(value)
        else:
            opened[key] = value
    return opened


def _or_parameter(node: Schema) -> Schema:
    takes_any_text = node.get("type") == "string" and node.keys() <= {"type", "description"}
    if "const" in node or takes_any_text:
        return node
    return {"anyOf": [_open_to_parameters(node), {"$ref": "#/$defs/Parameter"}]}
