"""The scene of a configuration, with a site for each of its frames that has an offset."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
from pydantic import BaseModel

from rmrc.config.models import Config
from rmrc.config.scene import source_of
from rmrc.model.scene import Scene, load_scene
from rmrc.text.base import Frame
from rmrc.text.source import Offset


def scene_of(config: Config) -> Scene:
    """Return the compiled scene of a configuration.

    Raises:
        ModelError: If there is no such file or robot, or it does not compile.
    """
    offsets = tuple(dict.fromkeys(_offsets(config)))
    return load_scene(source_of(config.scene), config.root, offsets)


def load_model(scene: str, root: Path) -> mujoco.MjModel:
    """Return the compiled model of a scene that is a file.

    Raises:
        ModelError: If there is no such file or robot, or it does not compile.
    """
    return load_scene(scene, root).model


def _offsets(value: Any) -> Iterator[Offset]:
    """Yield the offsets of all frames in a part of a configuration."""
    if isinstance(value, Frame):
        if value.displaced is not None:
            yield value.displaced
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from _offsets(getattr(value, name))
    elif isinstance(value, dict):
        for item in value.values():
            yield from _offsets(item)
    elif isinstance(value, tuple) and value and not isinstance(value[0], (int, float, str)):
        for item in value:
            yield from _offsets(item)
