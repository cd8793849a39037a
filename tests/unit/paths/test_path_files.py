"""Paths from files: their samples, and what is wrong with them."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sampled_paths import (
    COORDINATES,
    DIFFERENCE,
    EXACT,
    START,
    Array,
    difference,
    gap,
    rotation,
    sample,
)

from rmrc.errors import ConfigError
from rmrc.paths import FilePath
from rmrc.paths import file as file_module


def write_csv(folder: Path, text: str) -> FilePath:
    (folder / "poses.csv").write_text(text, encoding="utf-8")
    return FilePath(file="poses.csv")


def write_npz(folder: Path, **arrays: Any) -> FilePath:
    np.savez(folder / "poses.npz", **arrays)
    return FilePath(file="poses.npz")


def recording(count: int = 6, last: float = 2.0) -> tuple[Array, Array, Array]:
    """Times, positions and quaternions (of any norm and sign) of a recorded motion."""
    rng = np.random.default_rng(5)
    time = last * np.append(np.sort(rng.random(count - 1)), 1.0)
    return time, rng.normal(size=(count, 3)), rng.normal(size=(count, 4))


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_the_twist_of_a_file_is_the_derivative_of_the_pose(tmp_path: Path, coordinates) -> None:
    time, position, quaternion = recording()
    model = write_npz(tmp_path, time=time, position=position, quaternion=quaternion)
    trajectory = model.model_copy(update={"coordinates": coordinates, "delay": 0.3}).build(
        START, tmp_path
    )
    assert trajectory.duration == pytest.approx(time[-1] + 0.3, abs=EXACT)
    for at in np.random.default_rng(0).uniform(time[0] + 0.3, time[-1] + 0.3, 40):
        _, twist = sample(trajectory, at)
        np.testing.assert_allclose(twist, difference(trajectory, at), rtol=1e-6, atol=DIFFERENCE)


# Files.


def test_a_file_gives_its_samples_back(tmp_path: Path) -> None:
    time, position, quaternion = recording()
    table = np.column_stack([time, position, quaternion])
    lines = [",".join(map(repr, row)) for row in table.tolist()]
    header = "\ufefftime, x, y, z, qw, qx, qy, qz"
    text = write_csv(tmp_path, "\n".join([header, *lines[:3], "", *lines[3:]]) + "\n")
    arrays = write_npz(tmp_path, time=time, position=position, quaternion=quaternion)
    for model in (text, arrays):
        trajectory = model.build(START, tmp_path)
        assert trajectory.duration == time[-1]
        for at, *pose in zip(time, *position.T, *quaternion.T, strict=True):
            assert gap(sample(trajectory, at)[0], np.array(pose)) < EXACT
        before, after = sample(trajectory, time[0] / 2), sample(trajectory, time[-1] + 1)
        assert gap(before[0], np.array([*position[0], *quaternion[0]])) < EXACT
        assert gap(after[0], np.array([*position[-1], *quaternion[-1]])) < EXACT
        np.testing.assert_array_equal([before[1], after[1]], np.zeros((2, 6)))
        middle = sample(trajectory, (time[2] + time[3]) / 2)[0]
        np.testing.assert_allclose(middle[:3], (position[2] + position[3]) / 2, atol=EXACT)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_file_without_quaternions_keeps_the_orientation(tmp_path: Path, coordinates: str) -> None:
    model = write_csv(tmp_path, "time,x,y,z\n0,0,0,0\n1,0,0,1\n")
    trajectory = model.model_copy(update={"coordinates": coordinates}).build(START, tmp_path)
    pose, twist = sample(trajectory, 0.5)
    assert (rotation(pose) * rotation(START).inv()).magnitude() < EXACT
    np.testing.assert_array_equal(twist[3:], np.zeros(3))
    assert np.linalg.norm(twist[:3]) == pytest.approx(1.0, abs=EXACT)


def test_a_file_of_one_sample_and_of_huge_quaternions(tmp_path: Path) -> None:
    model = write_csv(tmp_path, "time,x,y,z,qw,qx,qy,qz\n0.5,1,2,3,3e200,0,4e200,0\n")
    trajectory = model.build(START, tmp_path)
    assert trajectory.duration == 0.5
    for time in (0.0, 0.5, 1.0):
        pose, twist = sample(trajectory, time)
        np.testing.assert_allclose(pose, [1, 2, 3, 0.6, 0, 0.8, 0], atol=EXACT)
        np.testing.assert_array_equal(twist, np.zeros(6))


HEADER = "time,x,y,z,qw,qx,qy,qz\n"
ROW = "0,1,2,3,1,0,0,0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"poses\.csv:1: the header must be time,x,y,z"),
        ("time,x,y\n0,1,2\n", r"poses\.csv:1: the header must be .*'time,x,y'"),
        ("time,x,y,z,qx,qy,qz,qw\n", r"poses\.csv:1: the header must be"),
        (HEADER, r"poses\.csv: there is no sample"),
        (HEADER + ROW + "1,1,2\n", r"poses\.csv:3: 8 numbers are wanted, and there are 3"),
        (HEADER + ROW + "\n1,1,2,3,1,0,0,one\n", r"poses\.csv:4: .*'one'"),
        (HEADER + ROW + "1,1,nan,3,1,0,0,0\n", r"poses\.csv:3: every number must be finite"),
        (HEADER + ROW + "inf,1,2,3,1,0,0,0\n", r"poses\.csv:3: every number must be finite"),
        (HEADER + ROW + "\n" + ROW, r"poses\.csv:4: the times must increase"),
        (HEADER + "-1" + ROW, r"poses\.csv:2: a time cannot be negative"),
        (HEADER + ROW + "1,1,2,3,0,0,0,0\n", r"poses\.csv:3: a quaternion of zero norm"),
        (HEADER + ROW + "1" * 200_000, r"poses\.csv:3: field larger than field limit"),
    ],
)
def test_a_csv_mistake_names_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        write_csv(tmp_path, text).build(START, tmp_path)


TIMES, POINTS = [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"time": TIMES}, r"the arrays must be .* it holds time \(2,\)"),
        ({"time": TIMES, "position": [[0.0, 1.0]]}, r"the arrays must be .*position \(1, 2\)"),
        ({"time": TIMES, "position": POINTS, "quaternions": POINTS}, "the arrays must be"),
        ({"time": ["a", "b"], "position": POINTS}, "all of numbers"),
        ({"time": [], "position": np.zeros((0, 3))}, "there is no sample"),
        ({"time": [0.0, 0.0], "position": POINTS}, r"sample 1: the times must increase"),
        ({"time": [0.0, np.nan], "position": POINTS}, r"sample 1: every number must be finite"),
        (
            {"time": TIMES, "position": POINTS, "quaternion": np.eye(2, 4, 1) * [[0], [1]]},
            r"sample 0: a quaternion of zero norm",
        ),
        ({"time": np.array([{}, {}]), "position": POINTS}, "not a readable NPZ file"),
    ],
)
def test_an_npz_mistake_names_its_sample(tmp_path: Path, arrays: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=r"poses\.npz: .*" + message):
        write_npz(tmp_path, **arrays).build(START, tmp_path)


def test_a_file_that_cannot_be_read_is_explained(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.csv: there is no such file"):
        FilePath(file="nowhere.csv").build(START, tmp_path)
    with pytest.raises(ConfigError, match="File name too long"):
        FilePath(file="x" * 5000 + ".csv").build(START, tmp_path)
    (tmp_path / "latin.csv").write_bytes(b"time,x,y,z\n0,1,2,\xff\n")
    with pytest.raises(ConfigError, match=r"latin\.csv: it is not text in UTF-8"):
        FilePath(file="latin.csv").build(START, tmp_path)
    (tmp_path / "text.npz").write_text("time,x,y,z\n")
    with pytest.raises(ConfigError, match=r"text\.npz: it is not a readable NPZ file"):
        FilePath(file="text.npz").build(START, tmp_path)


def test_a_file_above_the_limit_is_refused_packed_or_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_module, "LARGEST_FILE", 2000)
    with pytest.raises(ConfigError, match=r"poses\.csv: .*MB are more than"):
        write_csv(tmp_path, "time,x,y,z\n" + "0,0,0,0\n" * 300).build(START, tmp_path)
    zeros = io.BytesIO()
    np.save(zeros, np.zeros(1000))
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", zeros.getvalue())
    assert (tmp_path / "bomb.npz").stat().st_size < 2000
    with pytest.raises(ConfigError, match="MB are more than") as caught:
        FilePath(file="bomb.npz").build(START, tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / 'bomb.npz'}: 0.0 MB")
