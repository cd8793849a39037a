"""Scenes: a MJCF or URDF file, or a robot of the MuJoCo Menagerie, to an `MjModel`."""

import copy
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from rmrc.errors import ModelError, instead
from rmrc.problem.frames import find, names

MENAGERIE = "menagerie:"


def load_model(scene: str, root: Path) -> mujoco.MjModel:
    """Return the compiled model of a scene.

    Args:
        scene: A path to a MJCF or URDF file, or menagerie:NAME, or menagerie:NAME/ENTRY.
        root: The folder that a relative path refers to.

    Raises:
        ModelError: If there is no such file or robot, or it does not compile.
    """
    path = _menagerie_path(scene) if scene.startswith(MENAGERIE) else _file_path(scene, root)
    return copy.copy(_compiled(path, path.stat().st_mtime_ns))


@lru_cache(maxsize=4)
def _compiled(path: Path, modified: int) -> mujoco.MjModel:
    """Compile a file once for each version of it; a G1 takes a second."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except Exception as failure:  # MuJoCo raises ValueError, and its plugins what they like
        reason = " ".join(str(failure).split())
        raise ModelError(f"scene '{path.name}' does not compile: {reason}") from None


def start_keyframe(model: mujoco.MjModel, start: object) -> str | None:
    """Return the keyframe that a run starts in: the one it names, else `home` where there is one.

    It gives all that the start does not say: coordinates, mocap poses and controls.
    """
    if isinstance(start, str):
        return start
    return "home" if "home" in names(model, "keyframe") else None


def place_mocap_bodies(model: mujoco.MjModel, start: object) -> None:
    """Have the model's mocap bodies where its start has them, and so every mjData made of it.

    Raises:
        ModelError: If the model has no such keyframe.
        ValueError: If a quaternion of its mocap bodies has zero norm.
    """
    keyframe = start_keyframe(model, start)
    if keyframe is None or not model.nmocap:
        return
    key = find(model, "keyframe", keyframe)
    bodies = np.flatnonzero(model.body_mocapid >= 0)
    quaternions = model.key_mquat[key].reshape(-1, 4)
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        raise ValueError(f"keyframe '{keyframe}' turns a mocap body by a quaternion of zero norm")
    order = model.body_mocapid[bodies]
    model.body_pos[bodies] = model.key_mpos[key].reshape(-1, 3)[order]
    model.body_quat[bodies] = (quaternions / lengths)[order]


LARGEST_SCENE = 10_000_000
"""Bytes of a scene file; meshes are files of their own. MuJoCo takes minutes for a larger one."""


def _file_path(scene: str, root: Path) -> Path:
    path = (root / scene).resolve() if scene else root
    if not path.is_file():
        nearby = sorted(p.name for p in path.parent.glob("*.xml")) if path.parent.is_dir() else []
        raise ModelError(f"there is no scene file '{scene}'{instead(path.name, nearby)}")
    if path.stat().st_size > LARGEST_SCENE:
        raise ModelError(f"scene '{scene}' is larger than {LARGEST_SCENE // 10**6} MB")
    return path


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
