"""`inspect` of whatever names a model: a configuration, or a scene."""

from pathlib import Path
from typing import Any

from rmrc.config.compiled_scene import scene_of
from rmrc.config.load import load
from rmrc.model.scene import load_scene
from rmrc.problem.compile import compile
from rmrc.runs.describe import inspect as inspect_scene


def inspect(name: str) -> dict[str, Any]:
    """Return what a model has, as plain data.

    Args:
        name: A YAML configuration, or a scene as a configuration names it.

    Raises:
        RmrcError: If there is no such file, or it is wrong.
    """
    if name.endswith((".yaml", ".yml")):
        config = load(name)
        return inspect_scene(scene_of(config), compile(config).objects)
    return inspect_scene(load_scene(name, Path.cwd()))
