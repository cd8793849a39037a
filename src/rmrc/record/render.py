"""Pictures of a run: the robot drawn off screen as a PNG, or as an animated GIF."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.config.compiled_scene import scene_of
from rmrc.config.models import Config
from rmrc.errors import RmrcError
from rmrc.model.frames import resolve
from rmrc.problem.start import place_mocap_bodies
from rmrc.record.run import Run
from rmrc.text.base import Frame

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# The kinds of picture, and their width and height in pixels unless it is said.
SIZES = {".png": (960, 720), ".gif": (640, 480)}
# The model's own camera that is used where there is one.
CAMERA = "overview"
# Poses along the run that any other camera has in sight.
CAMERA_POSES = 50
# Seconds after which a child that tries an OpenGL backend counts as failed.
PROBE_TIMEOUT = 60
# Geoms that MuJoCo may draw, the number that its own renderer has.
SCENE_GEOMS = 10_000
# Most pieces of the line that a frame has gone along, and its colour and share of the scene.
PATH_PIECES = 200
PATH_COLOUR = np.array([0.95, 0.45, 0.1, 1.0], dtype=np.float32)
PATH_WIDTH = 0.003

_BACKENDS = ("egl", "osmesa") if sys.platform == "linux" else ("",)
# What a backend must be able to do, run where its failure harms nobody.
_PROBE = """
import mujoco
context = mujoco.GLContext(16, 16)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100)
"""


def render(
    run: Run,
    output: str | Path,
    *,
    model: mujoco.MjModel | None = None,
    time: float | None = None,
    size: tuple[int, int] | None = None,
    fps: float = 20.0,
) -> Path:
    """Draw the robot to a file: `.png`, one pose, or `.gif`, the whole run at its own speed.

    The view is that of the model's camera `overview`, else of a free camera that has the robot
    in sight from the first pose to the last. The paths of the tasks' frames are drawn as lines.

    Args:
        run: The run.
        output: The file.
        model: The MuJoCo model; by default the scene of the run's configuration.
        time: The time of the pose of a PNG, s; by default the end.
        size: Width and height in pixels; by default 960 × 720, and 640 × 480 of a GIF.
        fps: Pictures a second in a GIF, at most 50.

    Returns:
        The file.

    Raises:
        RmrcError: If Pillow or an OpenGL library is missing, the model is another one, the
            run has no steps, or the file cannot be written.
        ModelError: If the scene cannot be loaded.
    """
    output = Path(output)
    kind = output.suffix.lower()
    if kind not in SIZES:
        raise RmrcError(f"'{output.name}' is neither a .png nor a .gif; rmrc draws these two")
    if not len(run.time):
        raise RmrcError("the run has no steps, so there is nothing to draw")
    pillow, size = _pillow(), size or SIZES[kind]
    if model is None:
        config = Config.model_validate(run.manifest["config"]).rooted(Path(run.manifest["root"]))
        model = scene_of(config).model
        place_mocap_bodies(model, config.start)
    assert model is not None
    if model.nq != run.q.shape[1]:
        raise RmrcError(f"the model has {model.nq} coordinates and the run {run.q.shape[1]}")
    if not output.parent.is_dir():
        raise RmrcError(f"there is no folder '{output.parent}' to write '{output.name}' to")
    delay = _delay(fps)
    rows = _frame_rows(run, delay) if kind == ".gif" else [_row_at(run, time)]
    images = [pillow.fromarray(image) for image in _draw(model, run, rows, *size)]
    try:
        if kind == ".png":
            images[0].save(output)
        else:
            _save_gif(images, output, delay)
    except OSError as mistake:
        raise RmrcError(f"cannot write '{output}': {mistake}") from mistake
    return output


def _pillow() -> Any:
    try:
        from PIL import Image
    except ImportError:
        raise RmrcError(
            "pictures need Pillow, which is not installed: pip install 'rmrc[render]'"
        ) from None
    return Image


def _delay(fps: float) -> float:
    """Return the time between two pictures of a GIF, s; the format counts in hundredths."""
    if not 0 < fps <= 50:
        raise RmrcError(f"a GIF has more than 0 and at most 50 pictures a second, not {fps:g}")
    return round(100 / fps) / 100


def _row_at(run: Run, time: float | None) -> int:
    """Return the row nearest to a time, the last one where there is none."""
    return len(run.time) - 1 if time is None else int(np.abs(run.time - time).argmin())


def _frame_rows(run: Run, delay: float) -> list[int]:
    """Return the rows of an animation's pictures, the last one included."""
    times = np.arange(run.time[0], run.time[-1], delay)
    return [*np.searchsorted(run.time, times).tolist(), len(run.time) - 1]


def _save_gif(images: list[Any], output: Path, delay: float) -> None:
    """Write an animation; one palette and no dithering keep the background still."""
    palette = images[len(images) // 2].quantize(256, method=0)
    first, *others = [image.quantize(palette=palette, dither=0) for image in images]
    milliseconds = round(1000 * delay)
    first.save(output, save_all=True, append_images=others, duration=milliseconds, loop=0)


def _draw(
    model: mujoco.MjModel, run: Run, rows: list[int], width: int, height: int
) -> Iterator[Image]:
    """Yield one picture (height, width, 3) for each row of the run."""
    data = mujoco.MjData(model)
    paths, camera = _paths(model, data, run), _camera(model, data, run.q)
    scene = mujoco.MjvScene(model, maxgeom=SCENE_GEOMS + len(paths) * PATH_PIECES)
    option, viewport = mujoco.MjvOption(), mujoco.MjrRect(0, 0, width, height)
    picture = np.empty((height, width, 3), dtype=np.uint8)
    with _context(model, width, height) as context:
        for row in rows:
            data.qpos = run.q[row]
            if run.mocap is not None:
                data.mocap_pos, data.mocap_quat = np.split(
                    run.mocap[row].reshape(-1, 7), [3], axis=1
                )
            mujoco.mj_forward(model, data)
            mujoco.mjv_updateScene(
                model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
            )
            for path in paths:
                _add_line(scene, path, PATH_WIDTH * model.stat.extent)
            mujoco.mjr_render(viewport, scene, context)
            mujoco.mjr_readPixels(picture, None, viewport, context)
            yield picture[::-1].copy()  # OpenGL's first row is the lowest.


def _paths(model: mujoco.MjModel, data: mujoco.MjData, run: Run) -> list[Array]:
    """Return the path (n, 3) of each frame that a task of type `frame` moves."""
    frames = [
        resolve(model, Frame(**task.get("frame", {})))
        for task in run.manifest["config"]["tasks"]
        if task["type"] == "frame"
    ]
    paths = np.empty((len(frames), min(len(run.q), PATH_PIECES + 1), 3))
    for k, row in enumerate(np.linspace(0, len(run.q) - 1, paths.shape[1]).astype(int)):
        data.qpos = run.q[row]
        mujoco.mj_kinematics(model, data)
        for path, frame in zip(paths, frames, strict=True):
            path[k] = frame.views(data)[0]
    return list(paths)


def _add_line(scene: mujoco.MjvScene, path: Array, width: float) -> None:
    for start, end in pairwise(path):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom,
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            np.zeros(3),
            np.zeros(3),
            np.zeros(9),
            PATH_COLOUR,
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, width, start, end)
        scene.ngeom += 1


def _camera(model: mujoco.MjModel, data: mujoco.MjData, q: Array) -> mujoco.MjvCamera:
    """Return the camera `overview`, or a free one that sees the geoms all along the run (N, nq)."""
    camera = mujoco.MjvCamera()
    fixed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if fixed >= 0:
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, fixed
        return camera
    mujoco.mjv_defaultFreeCamera(model, camera)
    solid = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
    if not solid.any():
        return camera
    offset, half = np.split(model.geom_aabb[solid], 2, axis=1)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for row in np.linspace(0, len(q) - 1, CAMERA_POSES).astype(int):
        data.qpos = q[row]
        mujoco.mj_kinematics(model, data)
        rotation = data.geom_xmat[solid].reshape(-1, 3, 3)
        centre = data.geom_xpos[solid] + np.einsum("gij,gj->gi", rotation, offset)
        reach = np.einsum("gij,gj->gi", np.abs(rotation), half)
        low = np.minimum(low, (centre - reach).min(axis=0))
        high = np.maximum(high, (centre + reach).max(axis=0))
    camera.lookat = (low + high) / 2
    # The sphere around that box fills the field of view.
    radius = np.linalg.norm(high - low) / 2
    camera.distance = radius / np.sin(np.radians(model.vis.global_.fovy) / 2)
    return camera


@contextmanager
def _context(model: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.MjrContext]:
    """Give an off-screen OpenGL context of the first backend that works.

    MuJoCo's `Renderer` has its backend from the time that mujoco was imported; this one need
    not be chosen before.
    """
    backend = _backend()
    module = import_module(f"mujoco.{backend}") if backend in ("egl", "osmesa") else mujoco
    window = module.GLContext(width, height)
    window.make_current()
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
    try:
        mujoco.mjr_resizeOffscreen(width, height, context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        yield context
    finally:
        context.free()
        window.free()


def _backend() -> str:
    """Return the backend that MUJOCO_GL names, else the first one that works.

    Raises:
        RmrcError: If none works.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    for backend in (asked,) if asked else _BACKENDS:
        if _works(backend):
            return backend
    if asked:
        raise RmrcError(
            f"MUJOCO_GL={asked} cannot draw on this machine; unset it to let rmrc choose"
        )
    raise RmrcError(
        "drawing needs an OpenGL library that works without a screen. On Debian and Ubuntu: "
        "apt-get install libegl1 libgl1-mesa-dri, or apt-get install libosmesa6"
    )


@cache
def _works(backend: str) -> bool:
    """Return whether MuJoCo can draw with a backend, tried in a process of its own.

    In this process a failed try would stay: PyOpenGL binds to the first platform it meets.
    """
    try:
        child = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=os.environ | {"MUJOCO_GL": backend},
            capture_output=True,
            timeout=PROBE_TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return child.returncode == 0
