"""xacro to URDF, by the package `xacrodoc`, without ROS."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rmrc.errors import ModelError
from rmrc.model.packages import Packages


def is_xacro(path: Path, text: bytes) -> bool:
    """Tell whether a file is to be expanded before it is a URDF."""
    return path.suffix == ".xacro" or (b"xmlns:xacro" in text and b"<xacro:" in text)


def expand(path: Path, arguments: dict[str, str], packages: Packages) -> str:
    """Return the URDF that a xacro stands for.

    Args:
        path: The file.
        arguments: Its arguments by name.
        packages: Where `$(find …)` leads.

    Raises:
        ModelError: If it cannot be expanded, or `xacrodoc` is not installed.
    """
    try:
        from xacrodoc import XacroDoc
        from xacrodoc import packages as finder
    except ImportError:
        raise ModelError(
            f"scene '{path.name}' is a xacro, which needs the package xacrodoc: "
            "pip install 'rmrc[urdf]'"
        ) from None
    finder.reset()
    _Finder(packages).install(finder)
    try:
        with _quiet():
            document = XacroDoc.from_includes(
                [str(path)], subargs=dict(arguments), resolve_packages=False
            )
            return document.to_urdf_string()
    except ModelError:
        raise
    except Exception as failure:  # xacro's own errors, and those of expressions inside the file
        reason = " ".join(str(failure).split())
        raise ModelError(
            f"scene '{path.name}' cannot be expanded: {reason or type(failure).__name__}"
            f"{_hint(reason)}"
        ) from None
    finally:
        finder.reset()


class _Finder:
    """Has xacrodoc look for packages where we do."""

    def __init__(self, packages: Packages):
        self._packages = packages

    def install(self, finder: object) -> None:
        missing: type[Exception] = finder.PackageNotFoundError  # pyright: ignore

        def find(name: str) -> str:
            folder = self._packages.folder(name)
            if folder is None:
                raise missing(name)
            return str(folder)

        finder._finder.finder_funcs.insert(0, (find, missing))  # pyright: ignore


def _hint(reason: str) -> str:
    if "Undefined substitution argument" in reason:
        return "; give it in the scene's `arguments`, as in {file: …, arguments: {name: value}}"
    if "ackage not found" in reason:
        return (
            "; say where it is in the scene's `packages`, as in {file: …, packages: {name: path}}"
        )
    return ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what xacro writes to the terminal away from it."""
    from contextlib import redirect_stderr, redirect_stdout

    with (
        open(os.devnull, "w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        yield
