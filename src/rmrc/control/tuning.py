"""Changes of a configuration while a controller runs, validated as the configuration is."""

from typing import Any

from rmrc.config.models import Config
from rmrc.errors import ModelError, unknown_name
from rmrc.text.base import Model


def with_task(config: Config, name: str, changes: dict[str, Any]) -> Config:
    """Return a configuration with other values of a task's keys.

    Raises:
        ModelError: If there is no such task.
        ConfigError: If a key or a value is wrong.
    """
    before = _task(config, name)
    changed = _changed(before, changes)
    made = tuple(changed if task is before else task for task in config.tasks)
    return config.model_copy(update={"tasks": made})


def weight_of(config: Config, name: str) -> Any:
    """Return the B of a task.

    Raises:
        ModelError: If there is no such task, or it has no B.
    """
    task = _task(config, name)
    if "B" not in type(task).model_fields:
        raise ModelError(f"task '{name}' is a {task.type}, which has no weight to switch it off by")
    return task.B


def _task(config: Config, name: str) -> Any:
    tasks = {task.name: task for task in config.tasks}
    if name not in tasks:
        raise ModelError(unknown_name("task of the configuration", name, tasks))
    return tasks[name]


def with_limits(config: Config, changes: dict[str, Any]) -> Config:
    """Return a configuration with other values of keys of `limits`, each as a whole.

    A mapping for `collision` changes the keys that it names, its pairs stay.

    Raises:
        ConfigError: If a key or a value is wrong.
    """
    collision, given = config.limits.collision, changes.get("collision")
    if isinstance(given, dict) and isinstance(collision, Model):
        changes = changes | {"collision": _changed(collision, given)}
    return config.model_copy(update={"limits": _changed(config.limits, changes)})


def _changed(model: Model, changes: dict[str, Any]) -> Any:
    """Return a part of a configuration with other values, validated as a whole."""
    kept = {key: getattr(model, key) for key in model.model_fields_set if key not in changes}
    return type(model)(**kept, **changes)
