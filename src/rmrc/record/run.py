"""`Run`: what a run did, row by row, and the folder that holds it."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rmrc.errors import RmrcError
from rmrc.record.folder import FolderKind, plain, write_json
from rmrc.record.form import check_manifest
from rmrc.record.report import write_report

Array = NDArray[np.float64]

FORMAT = 1
MANIFEST = "run.json"
TRAJECTORY = "trajectory.npz"
REPORT = "report.html"
RUN_FOLDER = FolderKind("run", (MANIFEST, TRAJECTORY))

# Every array but the errors: its type, and the model's dimension that its rows have.
_ARRAYS: dict[str, tuple[DTypeLike, str | None]] = {
    "time": (np.float64, None),
    "q": (np.float64, "nq"),
    "v": (np.float64, "nv"),
    "v_measured": (np.float64, "nv"),
    "status": (np.uint8, None),
    "sigma_min": (np.float64, None),
    "active": (np.int8, "nv"),
    "kkt": (np.float64, None),
    "step_time": (np.float64, None),
    "q_commanded": (np.float64, "nq"),
    "mocap": (np.float64, "mocap"),
}
_OPTIONAL = ("q_commanded", "mocap")
_FINITE = ("time", "q", "v", "step_time", "mocap")
_MANIFEST_KEYS = ("name", "config", "root", "versions", "statuses", "model", "tasks", "summary")


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """A struct of arrays, row k the state at time t_k before its step, and a manifest.

    The manifest is plain data, as `run.json` holds it: `name`, `config` (resolved), `config_hash`,
    `root` (the folder that the config's relative paths refer to), `versions`, `seed`, `statuses`
    (names by value), `model` (`nq`, `nv` and `joints`: `name`, `type`, addresses `qpos` and `dof`,
    `unit`, `range` or null, `velocity` and `acceleration` or null), `tasks` (`type` and the
    `units` of the error's columns, by name), `summary`, and where there are any `notices` and
    `interrupted`. What is not finite in it becomes null.

    Raises:
        RmrcError: If a key of the manifest is missing, or an array does not fit it, is not finite
            where it must be, or is a time that does not rise.
    """

    time: Array
    """t in s (N,)."""
    q: Array
    """Configurations (N, nq)."""
    v: Array
    """Commanded velocities (N, nv)."""
    v_measured: Array
    """Measured velocities (N, nv)."""
    status: NDArray[np.uint8]
    """Index into the manifest's `statuses` (N,)."""
    error: dict[str, Array]
    """True error of each task (N, k), in the units that the manifest gives its columns."""
    sigma_min: Array
    """Smallest singular value of the tasks' Jacobian (N,), NaN where not computed."""
    active: NDArray[np.int8]
    """−1 where the lower bound is active, 1 where the upper, else 0 (N, nv)."""
    kkt: Array
    """Largest KKT residual (N,)."""
    step_time: Array
    """Time that the step took to compute, s (N,)."""
    manifest: dict[str, Any]
    q_commanded: Array | None = None
    """Set points of the joint controllers (N, nq); None where nothing stands between them and q."""
    mocap: Array | None = None
    """Poses of the mocap bodies, xyz + wxyz (N, 7 nmocap); None where none moves."""
    margin: dict[str, Array] = field(default_factory=dict)
    """Room to each limit on distances and speeds (N,), below 0 where it is passed; a lower bound
    where nothing is near."""

    def __post_init__(self):
        manifest = {"format": FORMAT, **plain(self.manifest)}
        if missing := [key for key in _MANIFEST_KEYS if key not in manifest]:
            raise RmrcError(f"the manifest has no '{missing[0]}'")
        object.__setattr__(self, "manifest", manifest)
        rows = len(self.time)
        for name, (dtype, dimension) in _ARRAYS.items():
            if name in _OPTIONAL and getattr(self, name) is None:
                continue
            width = () if dimension is None else (int(manifest["model"].get(dimension, 0)),)
            array = _fitting(name, getattr(self, name), dtype, (rows, *width))
            if name in _FINITE and not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                raise RmrcError(f"array '{name}' is not finite in row {row}")
            object.__setattr__(self, name, array)
        if (late := np.flatnonzero(np.diff(self.time) <= 0.0)).size:
            raise RmrcError(f"array 'time' does not rise after row {late[0]}")
        errors = {}
        for name, task in manifest["tasks"].items():
            if name not in self.error:
                raise RmrcError(f"there is no array 'error.{name}'")
            shape = (rows, len(task["units"]))
            errors[name] = _fitting(f"error.{name}", self.error[name], np.float64, shape)
        object.__setattr__(self, "error", errors)
        margins = {
            kind: _fitting(f"margin.{kind}", values, np.float64, (rows,))
            for kind, values in self.margin.items()
        }
        object.__setattr__(self, "margin", margins)
        if manifest["summary"].get("steps", rows) != rows:
            raise RmrcError(
                f"there are {rows} rows, and summary.steps is {manifest['summary']['steps']}"
            )
        if rows and self.status.max() >= len(manifest["statuses"]):
            raise RmrcError(f"array 'status' has the value {self.status.max()}, which has no name")

    def __repr__(self) -> str:
        return f"<Run '{self.manifest['name']}' of {len(self.time)} steps>"

    @property
    def summary(self) -> dict[str, Any]:
        """The run in numbers, as `rmrc.record.summary.summarize` gives it."""
        return self.manifest["summary"]

    def save(self, directory: str | Path, *, overwrite: bool = False, report: bool = True) -> Path:
        """Write the run folder: exactly `directory`, which is whole afterwards or as it was.

        Args:
            directory: The folder; if it exists it must be empty.
            overwrite: Allow it to be another run folder, which is replaced.
            report: Write `report.html` too.

        Raises:
            RmrcError: If the folder is in the way or cannot be written.
        """
        return RUN_FOLDER.save(directory, self._writer(report), overwrite=overwrite)

    def save_numbered(self, parent: str | Path, *, report: bool = True) -> Path:
        """Write the run folder as `parent`/NAME-0001, counting up; return it.

        Two processes that save at once get two numbers.

        Raises:
            RmrcError: If the folder cannot be written.
        """
        return RUN_FOLDER.save_numbered(parent, self.manifest["name"], self._writer(report))

    @classmethod
    def load(cls, directory: str | Path) -> "Run":
        """Read a run folder.

        Raises:
            RmrcError: If it is not a run folder, or is damaged; the message says what is wrong.
        """
        directory = Path(directory)
        if not (directory / MANIFEST).is_file():
            raise RmrcError(f"'{directory}' is not a run folder: there is no {MANIFEST} in it")
        manifest = _read_manifest(directory / MANIFEST)
        arrays = _read_arrays(directory / TRAJECTORY)
        if missing := [name for name in _ARRAYS if name not in (*arrays, *_OPTIONAL)]:
            raise RmrcError(f"'{directory / TRAJECTORY}' has no array '{missing[0]}'")
        error, margin = (
            {
                name.removeprefix(prefix): array
                for name, array in arrays.items()
                if name.startswith(prefix)
            }
            for prefix in ("error.", "margin.")
        )
        try:
            present = {name: arrays[name] for name in _ARRAYS if name in arrays}
            return cls(**present, error=error, margin=margin, manifest=manifest)
        except RmrcError as mistake:
            raise RmrcError(f"'{directory}' is damaged: {mistake}") from None

    def _writer(self, report: bool) -> Callable[[Path], None]:
        """Return what writes the files of the run folder."""

        def write(folder: Path) -> None:
            write_json(folder / MANIFEST, self.manifest)
            _write_arrays(folder / TRAJECTORY, self._arrays())
            if report:
                write_report(self, folder / REPORT)

        return write

    def _arrays(self) -> dict[str, NDArray[Any]]:
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        for name in _OPTIONAL:
            if arrays[name] is None:
                del arrays[name]
        return (
            arrays
            | {f"error.{name}": array for name, array in self.error.items()}
            | {f"margin.{kind}": array for kind, array in self.margin.items()}
        )


def _fitting(
    name: str, array: NDArray[Any], dtype: DTypeLike, shape: tuple[int, ...]
) -> NDArray[Any]:
    if array.shape != shape:
        raise RmrcError(f"array '{name}' has the shape {array.shape}, and {shape} is wanted")
    if array.dtype.kind not in "biuf":
        raise RmrcError(f"array '{name}' holds {array.dtype}, not numbers")
    return np.ascontiguousarray(array, dtype)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as mistake:
        raise RmrcError(f"'{path}' is damaged: {mistake}") from None
    if not isinstance(manifest, dict) or "format" not in manifest:
        raise RmrcError(f"'{path}' is not a run's manifest: it has no 'format'")
    if manifest["format"] != FORMAT:
        raise RmrcError(
            f"'{path}' has format {manifest['format']!r}, and this version reads format {FORMAT}"
        )
    try:
        check_manifest(manifest)
    except RmrcError as mistake:
        raise RmrcError(f"'{path}' is damaged: {mistake}") from None
    return manifest


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    if not path.is_file():
        raise RmrcError(f"'{path.parent}' is damaged: there is no {TRAJECTORY} in it")
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = {}
            for entry in archive.namelist():
                with archive.open(entry) as file:
                    array = np.lib.format.read_array(file, allow_pickle=False)
                arrays[entry.removesuffix(".npy")] = array
            return arrays
    except Exception as mistake:  # numpy's and zipfile's parsers raise whatever they trip over
        raise RmrcError(f"'{path}' is damaged: {mistake}") from None


def _write_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an npz whose entries carry no date, so that equal arrays are equal bytes."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
