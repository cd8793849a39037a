"""Pictures of a run: their size, what is in them, and what is said when nothing can draw."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from fabricated_runs import fabricated, hinge
from PIL import Image

from rmrc.errors import RmrcError
from rmrc.record import render as render_module
from rmrc.record.render import render
from rmrc.record.run import Run

ARM = """
<mujoco>
  <worldbody>
    <light pos="0 -2 3"/>
    {camera}
    <geom type="plane" size="1 1 0.1" rgba="0.2 0.2 0.2 1"/>
    <body pos="0 0 0.3">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" rgba="0.2 0.4 0.9 1"/>
      <body pos="0.4 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" rgba="0.2 0.4 0.9 1"/>
        <site name="hand" pos="0.3 0 0" size="0.001"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
CAMERA = '<camera name="overview" pos="0 -3 0.5" xyaxes="1 0 0 0 0 1"/>'
SIZE = (160, 120)


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip, by name, where no OpenGL library draws without a screen."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        render_module._backend()
    except RmrcError:
        pytest.skip("needs EGL or OSMesa")


@pytest.fixture
def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(camera=""))


@pytest.fixture(scope="module")
def run() -> Run:
    """Half a second in which the arm rises, with a task for its hand."""
    joints = [hinge("shoulder", 0, 0), hinge("elbow", 1, 1)]
    run = fabricated({"nq": 2, "nv": 2, "joints": joints}, steps=250)
    rising = np.linspace([0.0, 0.0], [-1.0, -1.0], 250)
    tasks = [
        {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
        {"name": "posture", "type": "posture"},
    ]
    config = {"scene": "arm.xml", "tasks": tasks}
    return replace(run, q=rising, manifest=run.manifest | {"config": config})


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def orange(image: np.ndarray) -> int:
    red, green, blue = np.moveaxis(image, -1, 0)
    return int(np.count_nonzero((red > 1.5 * green) & (green > 1.5 * blue) & (red > 60)))


def blue(image: np.ndarray) -> np.ndarray:
    return image[..., 2] > 1.5 * image[..., 0] + 10


@pytest.mark.usefixtures("backend")
def test_a_png_shows_the_last_pose_or_the_one_asked_for(
    run: Run, arm: mujoco.MjModel, tmp_path: Path
) -> None:
    last = render(run, tmp_path / "last.png", model=arm, size=SIZE)
    first = render(run, tmp_path / "first.png", model=arm, time=0.0, size=SIZE)
    assert last == tmp_path / "last.png"
    assert pixels(last).shape == (120, 160, 3)
    # The arm ends up higher in the picture than it began, and all of it is in the picture.
    rows = [np.flatnonzero(blue(pixels(path)).any(axis=1)) for path in (first, last)]
    columns = np.flatnonzero(blue(pixels(last)).any(axis=0))
    assert rows[1].min() < rows[0].min() - 5
    assert 0 < rows[1].min() < rows[1].max() < 119
    assert 0 < columns.min() < columns.max() < 159


@pytest.mark.usefixtures("backend")
def test_the_path_of_a_task_is_drawn(run: Run, arm: mujoco.MjModel, tmp_path: Path) -> None:
    without = replace(run, manifest=run.manifest | {"config": {"tasks": [{"type": "posture"}]}})
    drawn = [
        orange(pixels(render(each, tmp_path / "a.png", model=arm, size=SIZE)))
        for each in (run, without)
    ]
    assert drawn[0] > 20
    assert drawn[1] == 0


@pytest.mark.usefixtures("backend")
def test_the_scene_comes_from_the_config_and_its_camera_is_used(run: Run, tmp_path: Path) -> None:
    rooted = replace(run, manifest=run.manifest | {"root": str(tmp_path)})
    pictures = []
    for camera in ("", CAMERA):
        (tmp_path / "arm.xml").write_text(ARM.format(camera=camera))
        pictures.append(pixels(render(rooted, tmp_path / "a.png", size=SIZE)))
    assert (pictures[0] != pictures[1]).mean() > 0.1


@pytest.mark.usefixtures("backend")
def test_a_picture_may_be_larger_than_the_models_own_buffer(
    run: Run, arm: mujoco.MjModel, tmp_path: Path
) -> None:
    assert arm.vis.global_.offwidth < 800
    path = render(run, tmp_path / "a.png", model=arm, size=(800, 600))
    assert blue(pixels(path)).any()
    assert pixels(path).shape == (600, 800, 3)
    assert arm.vis.global_.offwidth < 800


@pytest.mark.usefixtures("backend")
def test_a_gif_runs_at_the_runs_own_speed(run: Run, arm: mujoco.MjModel, tmp_path: Path) -> None:
    path = render(run, tmp_path / "a.gif", model=arm, size=SIZE)
    with Image.open(path) as gif:
        assert gif.size == SIZE
        # A picture every 50 ms of 0.498 s, and the last pose.
        assert getattr(gif, "n_frames", 1) == 11
        assert gif.info["duration"] == 50


def test_a_delay_that_the_format_cannot_have_changes_the_times_not_the_speed(run: Run) -> None:
    delay = render_module._delay(30)
    assert delay == 0.03
    rows = render_module._frame_rows(run, delay)
    assert run.time[rows[:-1]] == pytest.approx(delay * np.arange(len(rows) - 1))


# What cannot be drawn


@pytest.mark.parametrize(
    ("output", "change", "message"),
    [
        ("a.jpg", lambda run: run, "neither a .png nor a .gif"),
        ("nowhere/a.png", lambda run: run, "there is no folder '.*nowhere' to write 'a.png' to"),
        ("a.png", lambda run: fabricated(run.manifest["model"], steps=0), "has no steps"),
        ("a.png", lambda run: fabricated(arm_of(3), steps=2), "has 2 coordinates .* run 3"),
    ],
)
def test_what_cannot_be_drawn_is_said(
    run: Run,
    arm: mujoco.MjModel,
    tmp_path: Path,
    output: str,
    change: Callable[[Run], Run],
    message: str,
) -> None:
    with pytest.raises(RmrcError, match=message):
        render(change(run), tmp_path / output, model=arm)


def arm_of(joints: int) -> dict[str, Any]:
    return {"nq": joints, "nv": joints, "joints": [hinge(str(i), i, i) for i in range(joints)]}


def test_too_many_pictures_a_second_are_refused(
    run: Run, arm: mujoco.MjModel, tmp_path: Path
) -> None:
    with pytest.raises(RmrcError, match="at most 50 pictures a second, not 60"):
        render(run, tmp_path / "a.gif", model=arm, fps=60)


def test_without_pillow_the_extra_is_named(
    run: Run, arm: mujoco.MjModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(RmrcError, match=r"pip install 'rmrc\[render\]'"):
        render(run, tmp_path / "a.png", model=arm)


def test_without_opengl_the_packages_are_named(
    run: Run, arm: mujoco.MjModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(render_module, "_works", lambda _: False)
    packages = "apt-get install libegl1 libgl1-mesa-dri, or apt-get install libosmesa6"
    with pytest.raises(RmrcError, match=packages):
        render(run, tmp_path / "a.png", model=arm)
    assert not (tmp_path / "a.png").exists()


def test_backends_are_tried_in_order_and_the_users_choice_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def works(backend: str) -> bool:
        tried.append(backend)
        return backend == "osmesa"

    monkeypatch.setattr(render_module, "_works", works)
    monkeypatch.setattr(render_module, "_BACKENDS", ("egl", "osmesa"))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    assert render_module._backend() == "osmesa"
    assert tried == ["egl", "osmesa"]
    monkeypatch.setenv("MUJOCO_GL", "EGL")
    with pytest.raises(RmrcError, match="MUJOCO_GL=egl cannot draw"):
        render_module._backend()
    assert tried[2:] == ["egl"]


def test_a_backend_that_hangs_or_dies_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*arguments: Any, timeout: float, **_: Any) -> None:
        raise subprocess.TimeoutExpired(arguments, timeout)

    assert not render_module._works.__wrapped__("nonsense")
    monkeypatch.setattr(subprocess, "run", hang)
    assert not render_module._works.__wrapped__("egl")
