"""From a file to a `Config`, and back to text with the origin of every value."""

from collections.abc import Mapping
from os.path import normpath
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from rmrc.config.compiled_scene import scene_of
from rmrc.config.models import Config
from rmrc.config.names import disagreements, unknown_names
from rmrc.config.scene import SceneValue, source_of
from rmrc.errors import ModelError
from rmrc.model.scene import load_scene
from rmrc.tasks import Task
from rmrc.text.annotations import tagged
from rmrc.text.document import Document
from rmrc.text.explain import explain
from rmrc.text.mistakes import Mistake, config_error
from rmrc.text.origins import annotated
from rmrc.text.overrides import apply, parse_override, parse_sweep, swept
from rmrc.text.read import read
from rmrc.text.stacks import expand

__all__ = ["load", "parse_override", "parse_sweep", "show", "swept"]


def load(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Config:
    """Read a configuration: stacks taken in, overrides set, names held against the model.

    Args:
        path: The YAML file; relative paths in it are relative to its folder.
        overrides: Values by path, as in ``{"solver.backend": "osqp", "tasks[0].gain": 5}``.

    Raises:
        ConfigError: With every mistake there is, each with its place.
    """
    file, name = Path(path), normpath(path)
    root, mistakes = expand(read(file, name), file, name)
    complete = not mistakes
    root, unreachable = apply(root, overrides or {})
    document, data = Document(root), root.plain
    folder = file.absolute().parent
    mistakes += unreachable
    follow_ups = _disagreements(data)
    config = None
    try:
        config = Config.model_validate(data, by_name=False)
    except ValidationError as error:
        mistakes += [
            mistake
            for mistake in explain(Config, data, error)
            # The tasks of a stack that is wrong are absent; what follows from that is no mistake.
            if complete or (mistake.location != ("tasks",) and mistake not in follow_ups)
        ]
    said = {mistake.location for mistake in mistakes}
    if complete:
        mistakes += [mistake for mistake in follow_ups if mistake.location not in said]
    mistakes += _model_mistakes(data, folder, config)
    if mistakes or config is None:
        raise config_error(mistakes, document)
    return config.rooted(folder, document)


def show(path: str | Path, overrides: Mapping[str, Any] | None = None) -> str:
    """Return a resolved configuration as YAML, each value with its origin in a comment.

    Raises:
        ConfigError: As `load` does.
    """
    config = load(path, overrides)
    return annotated(config.resolved(), config.document)


def _disagreements(data: dict[str, Any]) -> list[Mistake]:
    """Return which names of tasks and targets do not fit, whatever else is wrong."""
    items, targets = data.get("tasks"), data.get("targets")
    items = items if isinstance(items, list) else []
    kinds = tagged(Task)
    named = []
    for index, item in enumerate(items):
        if isinstance(item, dict) and isinstance(item.get("name"), str):
            kind = kinds.get(str(item.get("type")))
            named.append((index, item["name"], kind.target_kind if kind else "pose"))
    if not isinstance(targets, dict) or len(named) < len(items):
        targets = {}
    return disagreements(named, targets)


def _model_mistakes(data: dict[str, Any], folder: Path, config: Config | None) -> list[Mistake]:
    """Return the names that the scene's model does not have, or why there is no model."""
    try:
        if config is not None:
            scene = scene_of(config.rooted(folder))
        else:
            value = TypeAdapter(SceneValue).validate_python(data.get("scene"))
            scene = load_scene(source_of(value), folder)
    except ValidationError:
        return []
    except (ModelError, OSError, RuntimeError) as error:
        return [Mistake(("scene",), str(error))]
    return unknown_names(Config, data, scene.model)
