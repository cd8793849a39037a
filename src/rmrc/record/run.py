"""`Run`: what a run did, row by row, and the folder that holds it."""

import json
import math
import os
import re
import secrets
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rmrc.errors import RmrcError
from rmrc.record.report import write_report

Array = NDArray[np.float64]

FORMAT = 1
MANIFEST = "run.json"
TRAJECTORY = "trajectory.npz"
REPORT = "report.html"

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
}
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
        RmrcError: If a key of the manifest is missing or an array does not fit it.
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

    def __post_init__(self):
        manifest = {"format": FORMAT, **_plain(self.manifest)}
        if missing := [key for key in _MANIFEST_KEYS if key not in manifest]:
            raise RmrcError(f"the manifest has no '{missing[0]}'")
        object.__setattr__(self, "manifest", manifest)
        rows = len(self.time)
        for name, (dtype, dimension) in _ARRAYS.items():
            width = () if dimension is None else (int(manifest["model"][dimension]),)
            array = _fitting(name, getattr(self, name), dtype, (rows, *width))
            object.__setattr__(self, name, array)
        errors = {}
        for name, task in manifest["tasks"].items():
            if name not in self.error:
                raise RmrcError(f"there is no array 'error.{name}'")
            shape = (rows, len(task["units"]))
            errors[name] = _fitting(f"error.{name}", self.error[name], np.float64, shape)
        object.__setattr__(self, "error", errors)
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
        target = Path(directory).resolve()
        ensure_free(directory, overwrite=overwrite)
        with self._written_beside(target, report) as written:
            _move(written, target)
        return Path(directory)

    def save_numbered(self, parent: str | Path, *, report: bool = True) -> Path:
        """Write the run folder as `parent`/NAME-0001, counting up; return it.

        Two processes that save at once get two numbers.

        Raises:
            RmrcError: If the folder cannot be written.
        """
        name = re.sub(r"[^\w.\-]", "_", self.manifest["name"])
        with self._written_beside(Path(parent).resolve() / name, report) as written:
            for number in count(_last_number(written.parent, name) + 1):
                target = Path(parent) / f"{name}-{number:04d}"
                try:
                    # A folder that another process has put there makes the renaming fail.
                    written.rename(target)
                except OSError:
                    if not target.exists():
                        raise
                else:
                    return target
        raise AssertionError("unreachable")

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
        if missing := [name for name in _ARRAYS if name not in arrays]:
            raise RmrcError(f"'{directory / TRAJECTORY}' has no array '{missing[0]}'")
        error = {
            name.removeprefix("error."): array
            for name, array in arrays.items()
            if name.startswith("error.")
        }
        try:
            return cls(**{name: arrays[name] for name in _ARRAYS}, error=error, manifest=manifest)
        except RmrcError as mistake:
            raise RmrcError(f"'{directory}' is damaged: {mistake}") from None
        except (AttributeError, KeyError, TypeError, ValueError) as mistake:
            raise RmrcError(f"'{directory / MANIFEST}' is damaged: {mistake!r}") from None

    @contextmanager
    def _written_beside(self, target: Path, report: bool) -> Iterator[Path]:
        """Write a whole run folder under a temporary name beside `target`, to be moved there."""
        temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}"
        try:
            temporary.mkdir(parents=True)
            (temporary / MANIFEST).write_text(
                json.dumps(self.manifest, indent=2, ensure_ascii=False, allow_nan=False) + "\n",
                encoding="utf-8",
            )
            _write_arrays(temporary / TRAJECTORY, self._arrays())
            if report:
                write_report(self, temporary / REPORT)
            for path in (*temporary.iterdir(), temporary):
                _flush(path)
            yield temporary
            _flush(target.parent)
        except OSError as mistake:
            raise RmrcError(f"cannot save the run as '{target}': {mistake}") from mistake
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        return arrays | {f"error.{name}": array for name, array in self.error.items()}


def ensure_free(directory: str | Path, *, overwrite: bool = False) -> None:
    """Make sure that a run can be saved as `directory`, before it is run.

    Raises:
        RmrcError: If something is there that would be lost.
    """
    if not os.path.lexists(directory) or _is_empty(Path(directory)):
        _try_writing(Path(directory).resolve())
        return
    if not is_run_folder(directory):
        raise RmrcError(f"'{directory}' exists and is not a run folder; it stays as it is")
    if not overwrite:
        raise RmrcError(f"'{directory}' already holds a run; name another folder, or remove it")


def _try_writing(directory: Path) -> None:
    """Make and remove a folder where the run will be, so that a run is not lost at its end."""
    parent = next(folder for folder in directory.parents if os.path.lexists(folder))
    try:
        os.rmdir(tempfile.mkdtemp(prefix=".rmrc-", dir=parent))
    except OSError as mistake:
        raise RmrcError(f"cannot save a run in '{parent}': {mistake.strerror}") from None


def is_run_folder(directory: str | Path) -> bool:
    """Return whether a folder holds a run."""
    return all((Path(directory) / name).is_file() for name in (MANIFEST, TRAJECTORY))


def _plain(value: Any) -> Any:
    """Return a value as strict JSON can hold it: no numpy, no tuples, null for NaN and ±∞."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


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


def _move(written: Path, target: Path) -> None:
    """Move a folder to its place; a folder that is there is put aside first, then removed."""
    if not target.exists():
        written.rename(target)
        return
    aside = written.with_name(f"{written.name}-old")
    target.rename(aside)
    try:
        written.rename(target)
    except BaseException:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _flush(path: Path) -> None:
    """Make sure that a file, or the entries of a folder, are on the disk."""
    if os.name == "nt" and path.is_dir():
        return  # Windows gives no handle of a folder.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _is_empty(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _last_number(parent: Path, name: str) -> int:
    """Return the highest NUMBER of the entries NAME-NUMBER of a folder, or 0."""
    pattern = re.compile(re.escape(name) + r"-(\d{4,})")
    found = (pattern.fullmatch(entry.name) for entry in parent.iterdir())
    return max((int(match[1]) for match in found if match), default=0)
