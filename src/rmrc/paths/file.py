"""The path that a file lists: poses and the times at which the target has them."""

import csv
import pathlib
import zipfile
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from rmrc.errors import ConfigError
from rmrc.paths.base import MovingPath, Trajectory
from rmrc.paths.geometry import Transform, through
from rmrc.text.base import Pose

LARGEST_FILE = 10_000_000  # bytes
# The header of a CSV file: all of it, or the first four without an orientation.
POSE_COLUMNS = ["time", "x", "y", "z", "qw", "qx", "qy", "qz"]
# A quaternion of a smaller norm is no rotation.
LEAST_NORM = 1e-12


def _csv_or_npz(name: str) -> str:
    if not name.endswith((".csv", ".npz")):
        raise ValueError(f"the file of a path is a .csv or a .npz, and this is '{name}'")
    return name


class FilePath(MovingPath):
    """The poses of a file, linear in position and turning the shortest way from each to the next.

    A CSV file has the header `time,x,y,z` or `time,x,y,z,qw,qx,qy,qz`; an NPZ file has the arrays
    `time` (N,), `position` (N, 3) and, if wanted, `quaternion` (N, 4), wxyz. Times are in s from
    the start of the run, after the delay; positions are in m. Before the first time the target
    waits at the first pose; without quaternions its orientation stays as at the start.
    """

    path: Literal["file"] = "file"
    file: Annotated[str, AfterValidator(_csv_or_npz)]
    """Name of the CSV or NPZ file, relative to the configuration's folder."""

    def build(self, start: NDArray[np.float64], root: pathlib.Path) -> Trajectory:
        """Return the trajectory through the file's poses; see `PathModel.build`.

        Raises ConfigError, naming the file and the line, where the file cannot be used.
        """
        table = read_samples(root / self.file)
        here = Transform.from_array(start)
        frame = self.frame(here)
        places = [
            # The samples are checked already, once for the whole table.
            frame.place(Pose.model_construct(position=row[1:4], quaternion=row[4:] or None), here)
            for row in map(tuple, table.tolist())
        ]
        times = [self.delay + time for time in table[:, 0].tolist()]
        if len(places) == 1:  # a single sample is a motion from there to there
            places, times = places * 2, times * 2
        return Trajectory(through(places), times)


def read_samples(file: pathlib.Path) -> NDArray[np.float64]:
    """Return a file's samples, a row each: time, x, y, z (N, 4), or with a unit quaternion (N, 8).

    Raises ConfigError, naming the file and the line of a CSV or the sample of an NPZ, counted from
    0, where a number is missing, is not finite or is not one, where the times do not increase from
    0 or later, where a quaternion is zero, and where the file is absent, damaged or above 10 MB.
    """
    try:
        if not file.is_file():
            raise ConfigError(f"{file}: there is no such file")
        _refuse_above_limit(file, file.stat().st_size)
        table, where = (_read_csv if file.name.endswith(".csv") else _read_npz)(file)
    except OSError as error:
        raise ConfigError(f"{file}: {error.strerror}") from error
    if not len(table):
        raise ConfigError(f"{file}: there is no sample in it")
    time, quaternion = table[:, 0], table[:, 4:]
    for wrong, sentence in (
        (~np.isfinite(table).all(axis=1), "every number must be finite"),
        (time < 0.0, "a time cannot be negative"),
        (np.append(False, time[1:] <= time[:-1]), "the times must increase"),
        (
            (np.abs(quaternion) < LEAST_NORM).all(axis=1) & (quaternion.size > 0),
            "a quaternion of zero norm is no rotation; the identity is 1, 0, 0, 0",
        ),
    ):
        if wrong.any():
            raise ConfigError(f"{where(int(wrong.argmax()))}: {sentence}")
    # Divided by its largest part first, so that no square overflows.
    quaternion /= np.abs(quaternion).max(axis=1, initial=0.0, keepdims=True)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return table


def _refuse_above_limit(file: pathlib.Path, size: int) -> None:
    if size > LARGEST_FILE:
        raise ConfigError(
            f"{file}: {size / 1e6:.1f} MB are more than the {LARGEST_FILE / 1e6:.0f} MB"
            " that the file of a path may have"
        )


def _read_csv(file: pathlib.Path) -> tuple[NDArray[np.float64], Callable[[int], str]]:
    """Return the table of a CSV file, and the function that names the place of a row."""
    try:
        reader = csv.reader(file.read_text(encoding="utf-8-sig").splitlines())
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: it is not text in UTF-8") from error
    rows: list[list[float]] = []
    lines: list[int] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        if header not in (POSE_COLUMNS[:4], POSE_COLUMNS):
            raise ConfigError(
                f"{file}:1: the header must be {','.join(POSE_COLUMNS[:4])} or"
                f" {','.join(POSE_COLUMNS)}, and it is '{','.join(header)}'"
            )
        for row in filter(None, reader):
            if len(row) != len(header):
                raise ConfigError(
                    f"{file}:{reader.line_num}: {len(header)} numbers are wanted, and there are"
                    f" {len(row)}"
                )
            rows.append([float(cell) for cell in row])
            lines.append(reader.line_num)
    except (ValueError, csv.Error) as error:
        raise ConfigError(f"{file}:{reader.line_num}: {error}") from error
    return np.array(rows).reshape(-1, len(header)), lambda row: f"{file}:{lines[row]}"


def _read_npz(file: pathlib.Path) -> tuple[NDArray[np.float64], Callable[[int], str]]:
    """Return the table of an NPZ file, and the function that names the place of a row."""
    try:
        with zipfile.ZipFile(file) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        with np.load(file) as archive:
            _refuse_above_limit(file, unpacked)
            arrays = {name: np.asarray(archive[name]) for name in archive}
    except ConfigError:
        raise
    except Exception as error:  # a damaged archive raises a dozen kinds
        raise ConfigError(f"{file}: it is not a readable NPZ file: {error}") from error
    count = arrays["time"].size if "time" in arrays else 0
    shapes = {name: array.shape for name, array in arrays.items()}
    positions = {"time": (count,), "position": (count, 3)}
    if shapes not in (positions, {**positions, "quaternion": (count, 4)}) or any(
        array.dtype.kind not in "fiu" for array in arrays.values()
    ):
        held = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "none"
        raise ConfigError(
            f"{file}: the arrays must be time (N,), position (N, 3) and, if wanted,"
            f" quaternion (N, 4), all of numbers; it holds {held}"
        )
    columns = [arrays[name] for name in ("time", "position", "quaternion") if name in arrays]
    return np.column_stack(columns).astype(float), lambda row: f"{file}: sample {row}"
