"""From the name of a scene to its file."""

import importlib
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

from rmrc.errors import ModelError, instead
from rmrc.text.source import Source

MENAGERIE, DESCRIPTIONS = "menagerie:", "robot_descriptions:"
ENDINGS = (".xml", ".mjcf", ".urdf", ".xacro")
"""Of files that are scenes."""
LARGEST_SCENE = 10_000_000
"""Bytes of a scene file; meshes are files of their own. MuJoCo takes minutes for a larger one."""

_INCLUDE = re.compile(rb"<(?:xacro:)?include\s[^>]*?file(?:name)?\s*=\s*[\"']([^\"']+)")


def located(source: Source, root: Path) -> tuple[Source, Path]:
    """Return the file of a source, and the source with what is known of it besides.

    Args:
        source: A source whose `file` is a text, but not of XML.
        root: The folder that a relative path refers to.

    Raises:
        ModelError: If there is no such file or robot.
    """
    name = source.file
    assert isinstance(name, str)
    if name.startswith(MENAGERIE):
        return source, _menagerie_path(name)
    if name.startswith(DESCRIPTIONS):
        return _described(source, name)
    return source, _file_path(name, root)


def included(path: Path) -> list[Path]:
    """Return a file and all that it includes, as far as they are there, each once."""
    found, waiting = [path], [path]
    while waiting:
        including = waiting.pop()
        for name in _INCLUDE.findall(including.read_bytes()):
            # MuJoCo looks beside the file that is loaded, xacro beside the one that includes.
            for folder in (path.parent, including.parent):
                other = (folder / name.decode("utf-8", "replace")).resolve()
                if other not in found and other.is_file():
                    found.append(other)
                    waiting.append(other)
    return found


def _file_path(scene: str, root: Path) -> Path:
    path = (root / Path(scene).expanduser()).resolve() if scene else root
    if path.is_dir() and scene:
        path = _of_folder(scene, path)
    if not path.is_file():
        nearby = _scenes(path.parent) if path.parent.is_dir() else []
        raise ModelError(f"there is no scene file '{scene}'{instead(path.name, nearby)}")
    if path.stat().st_size > LARGEST_SCENE:
        raise ModelError(f"scene '{scene}' is larger than {LARGEST_SCENE // 10**6} MB")
    return path


def _scenes(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.suffix in ENDINGS)


def _of_folder(scene: str, folder: Path) -> Path:
    """Return the scene of a folder: its scene.xml, or its only file that can be one."""
    found = _scenes(folder)
    name = "scene.xml" if "scene.xml" in found else found[0] if len(found) == 1 else None
    if name is None:
        raise ModelError(f"scene '{scene}' is a folder; name a file in it{instead('', found)}")
    return folder / name


def _menagerie_path(scene: str) -> Path:
    name, _, entry = scene.removeprefix(MENAGERIE).partition("/")
    try:
        import mujoco_menagerie
    except ImportError:
        raise ModelError(
            f"scene '{scene}' needs the package mujoco-menagerie: pip install 'rmrc[menagerie]'"
        ) from None
    try:
        robot = mujoco_menagerie.get(name)
        robot.entry(entry or None)  # a wrong name must not fetch the whole robot first
        return robot.xml(entry or None)
    except (
        mujoco_menagerie.UnknownRobotError,
        mujoco_menagerie.UnknownEntryPointError,
    ) as unknown:
        raise ModelError(
            f"scene '{scene}' does not exist: {' '.join(str(unknown).split())}"
        ) from None
    except Exception as failure:  # its own errors, and those of a download
        reason = " ".join(str(failure).split())
        raise ModelError(
            f"scene '{scene}' cannot be had: {reason} "
            "(without a network, set MENAGERIE_ROOT to a checkout of the Menagerie)"
        ) from None


def _described(source: Source, scene: str) -> tuple[Source, Path]:
    """Return the file of one of `robot_descriptions`, fetched on first use."""
    name = scene.removeprefix(DESCRIPTIONS)
    try:
        from robot_descriptions._descriptions import (  # pyright: ignore[reportMissingImports]
            DESCRIPTIONS as KNOWN,
        )
    except ImportError:
        raise ModelError(
            f"scene '{scene}' needs the package robot_descriptions: pip install 'rmrc[urdf]'"
        ) from None
    candidates = (name, f"{name}_mj_description", f"{name}_description")
    module = next((candidate for candidate in candidates if candidate in KNOWN), None)
    if module is None:
        short = {known.removesuffix("_description").removesuffix("_mj") for known in KNOWN}
        raise ModelError(f"scene '{scene}' does not exist{instead(name, sorted(short))}")
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            found: Any = importlib.import_module(f"robot_descriptions.{module}")
    except Exception as failure:  # git's errors, and those of a download
        reason = " ".join(str(failure).split())
        raise ModelError(f"scene '{scene}' cannot be had: {reason}") from None
    kinds = ("MJCF_PATH", "URDF_PATH", "XACRO_PATH")
    path = next((Path(getattr(found, kind)) for kind in kinds if hasattr(found, kind)), None)
    if path is None or not path.is_file():
        raise ModelError(f"scene '{scene}' has no model file")
    package = Path(getattr(found, "PACKAGE_PATH", path.parent))
    arguments = dict(getattr(found, "XACRO_ARGS", {})) | dict(source.arguments)
    packages = {package.name: str(package)} | dict(source.packages)
    return (
        replace(source, arguments=tuple(arguments.items()), packages=tuple(packages.items())),
        path,
    )
