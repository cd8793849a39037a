"""Folders that are whole or absent: written under another name, then renamed."""

import json
import math
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from rmrc.errors import RmrcError

Write = Callable[[Path], None]
"""Writes the files of a folder into one that is there and empty."""


@dataclass(frozen=True)
class FolderKind:
    """A kind of folder, known by the files that each of them holds."""

    name: str
    """What one holds, as in `run`."""
    files: tuple[str, ...]

    def holds(self, directory: str | Path) -> bool:
        """Return whether a folder is of this kind."""
        return all((Path(directory) / name).is_file() for name in self.files)

    def ensure_free(self, directory: str | Path, *, overwrite: bool = False) -> None:
        """Make sure that `directory` can be saved, before the work that is to be saved there.

        Raises:
            RmrcError: If something is there that would be lost.
        """
        if not os.path.lexists(directory) or _is_empty(Path(directory)):
            self._try_writing(Path(directory).resolve())
            return
        if not self.holds(directory):
            raise RmrcError(
                f"'{directory}' exists and is not a {self.name} folder; it stays as it is"
            )
        if not overwrite:
            raise RmrcError(
                f"'{directory}' already holds a {self.name}; name another folder, or remove it"
            )

    def _try_writing(self, directory: Path) -> None:
        """Make and remove a folder beside `directory`, so that work is not lost at its end."""
        parent = next(folder for folder in directory.parents if os.path.lexists(folder))
        try:
            os.rmdir(tempfile.mkdtemp(prefix=".rmrc-", dir=parent))
        except OSError as mistake:
            reason = mistake.strerror
            raise RmrcError(f"cannot save a {self.name} in '{parent}': {reason}") from None

    def save(self, directory: str | Path, write: Write, *, overwrite: bool = False) -> Path:
        """Write exactly the folder `directory`, which is whole afterwards or as it was.

        Args:
            directory: The folder; if it exists it must be empty.
            write: Writes its files.
            overwrite: Allow it to be another folder of this kind, which is replaced.

        Raises:
            RmrcError: If the folder is in the way or cannot be written.
        """
        target = Path(directory).resolve()
        self.ensure_free(directory, overwrite=overwrite)
        with self._written_beside(target, write) as written:
            taken = _take(target, written)
            while not taken:
                # Something is there to be replaced, or has come there since by another process.
                self.ensure_free(directory, overwrite=overwrite)
                taken = _replace(target, written)
        return Path(directory)

    def save_numbered(self, parent: str | Path, name: str, write: Write) -> Path:
        """Write a folder as `parent`/NAME-0001, counting up; return it.

        Two processes that save at once get two numbers.

        Raises:
            RmrcError: If the folder cannot be written.
        """
        name = re.sub(r"[^\w.\-]", "_", name)
        with self._written_beside(Path(parent).resolve() / name, write) as written:
            for number in count(_last_number(written.parent, name) + 1):
                target = Path(parent) / f"{name}-{number:04d}"
                if _take(target, written):
                    return target
        raise AssertionError("unreachable")

    @contextmanager
    def _written_beside(self, target: Path, write: Write) -> Iterator[Path]:
        """Write a whole folder under a temporary name beside `target`, to be moved there."""
        temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}"
        try:
            temporary.mkdir(parents=True)
            write(temporary)
            for path in (*temporary.iterdir(), temporary):
                _flush(path)
            yield temporary
            _flush(target.parent)
        except OSError as mistake:
            raise RmrcError(f"cannot save the {self.name} as '{target}': {mistake}") from mistake
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def write_json(path: Path, value: Any) -> None:
    """Write a value, plain already, as strict JSON."""
    path.write_text(json_text(value, indent=2) + "\n", encoding="utf-8")


def json_text(value: Any, indent: int | None = None) -> str:
    """Return a value, plain already, as strict JSON that is safe to print."""
    text = json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=False)
    return "".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text)


def plain(value: Any) -> Any:
    """Return a value as strict JSON can hold it: no numpy, no tuples, null for NaN and ±∞."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _take(target: Path, written: Path) -> bool:
    """Give a whole folder its name; return False where another one has it.

    The renaming decides between processes: it fails where anything but an empty folder is there.
    """
    try:
        if os.name == "nt" and _is_empty(target):
            target.rmdir()  # Windows renames onto nothing at all.
        written.rename(target)
    except OSError:
        if not os.path.lexists(target):
            raise
        return False
    return True


def _replace(target: Path, written: Path) -> bool:
    """Put a folder aside and take its name; return False where another process has been faster."""
    aside = written.with_name(f"{written.name}-old")
    try:
        target.rename(aside)
    except FileNotFoundError:
        return _take(target, written)
    try:
        taken = _take(target, written)
    except BaseException:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)
    return taken


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
