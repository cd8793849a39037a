"""Where `package://` and `$(find …)` lead."""

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path


class Packages:
    """Folders of ROS packages by name, as seen from a file.

    A package is looked for among those that are given, in the folders above the file, and where
    ROS_PACKAGE_PATH and AMENT_PREFIX_PATH lead.
    """

    def __init__(self, given: Mapping[str, Path], file: Path):
        self._given, self._folders = dict(given), list(file.resolve().parents)
        self._known: dict[str, Path | None] = {}

    def folder(self, name: str) -> Path | None:
        """Return the folder of a package, if it is found."""
        if name not in self._known:
            self._known[name] = next(self._candidates(name), None)
        return self._known[name]

    def resolve(self, uri: str) -> Path:
        """Return the path that a URI or a relative path of the file stands for."""
        scheme, separator, rest = uri.partition("://")
        if not separator:
            return self._folders[0] / uri
        if scheme not in ("package", "model"):
            return Path("/" + rest.lstrip("/")) if scheme == "file" else Path(uri)
        name, _, inside = rest.partition("/")
        folder = self.folder(name)
        if folder is not None:
            return folder / inside
        # A package that was renamed or unpacked still has its folders beside each other.
        beside = (above / inside for above in self._folders[:3])
        return next((path for path in beside if path.is_file()), self._folders[0] / rest)

    def _candidates(self, name: str) -> Iterator[Path]:
        if name in self._given:
            yield self._given[name]
        for above in self._folders:
            if above.name == name or _declared(above) == name:
                yield above
            elif (above / name).is_dir():
                yield above / name
        for entry in _entries("ROS_PACKAGE_PATH"):
            found = [entry] if entry.name == name else [entry / name, *entry.glob(f"*/{name}")]
            yield from filter(Path.is_dir, found)
        for entry in _entries("AMENT_PREFIX_PATH"):
            if (entry / "share" / name).is_dir():
                yield entry / "share" / name


def _entries(variable: str) -> list[Path]:
    return [Path(part) for part in os.environ.get(variable, "").split(os.pathsep) if part]


def _declared(folder: Path) -> str | None:
    """Return the name of the package that a folder is, if it says so."""
    try:
        return ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        return None
