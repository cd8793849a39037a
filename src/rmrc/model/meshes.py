"""Meshes, textures and height fields of a spec: found, converted, or left out."""

import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

READABLE = (".stl", ".obj", ".msh")
"""What MuJoCo reads itself."""
MOST_FACES = 200_000
"""MuJoCo reads no STL file with more."""
_STL_HEADER, _STL_FACE = 84, 50
_TEXT = "a STL file that is text"


class Assets:
    """The files that a spec names; what cannot be had is taken out of it, and remembered."""

    def __init__(self, spec: mujoco.MjSpec, files: Mapping[str, Path]):
        self.spec, self._files = spec, files
        self.left_out: dict[str, str] = {}
        """Why each file is left out, by its name."""

    def settle(self, meshes: bool) -> None:
        """Convert what can be converted, and leave out what is missing; all meshes if asked."""
        for mesh in list(self.spec.meshes):
            if not mesh.file:
                continue
            path = self._path(mesh, "meshdir")
            if not meshes:
                self.leave_out(mesh, "meshes are off")
                continue
            why = _unreadable(path)
            if why == _TEXT or (why == "" and path.suffix.lower() not in READABLE):
                why = _convert(mesh, path)
            elif why == "" and mesh.file in self._files:
                mesh.file = str(path)
            if why:
                self.leave_out(mesh, why, path.name)
        self._settle_pictures()

    def leave_out(self, mesh: Any, why: str, name: str = "") -> None:
        """Take a mesh out of the spec, with all that is made of it."""
        self.left_out[name or Path(mesh.file).name or mesh.name] = why
        self._delete(geom for geom in self.spec.geoms if geom.meshname == mesh.name)
        self.spec.delete(mesh)

    def _delete(self, geoms: Iterable[Any]) -> None:
        """Take geoms out, and the pairs that name them."""
        for geom in list(geoms):
            for pair in list(self.spec.pairs):
                if geom.name and geom.name in (pair.geomname1, pair.geomname2):
                    self.spec.delete(pair)
            self.spec.delete(geom)

    def _settle_pictures(self) -> None:
        """Leave out textures and height fields that are missing."""
        gone = set()
        for texture in list(self.spec.textures):
            path = self._path(texture, "texturedir")
            if texture.file and not path.is_file():
                self.left_out[path.name] = "missing"
                gone.add(texture.name or path.stem)
                self.spec.delete(texture)
        for material in self.spec.materials if gone else ():
            material.textures = ["" if name in gone else name for name in material.textures]
        for field in list(self.spec.hfields):
            path = self._path(field, "meshdir")
            if field.file and not path.is_file():
                self.left_out[path.name] = "missing"
                self._delete(geom for geom in self.spec.geoms if geom.hfieldname == field.name)
                self.spec.delete(field)

    def _path(self, asset: Any, folder: str) -> Path:
        if asset.file in self._files:
            return self._files[asset.file]
        compiler = getattr(asset, "compiler", None) or self.spec.compiler
        inside = getattr(compiler, folder, "") or ""
        return Path(self.spec.modelfiledir or ".") / inside / asset.file

    def notices(self) -> list[str]:
        """Return one notice of all that is left out."""
        if not self.left_out:
            return []
        reasons: dict[str, list[str]] = {}
        for name, why in self.left_out.items():
            reasons.setdefault(why, []).append(name)
        said = "; ".join(f"{why}: {_listed(names)}" for why, names in reasons.items())
        count = len(self.left_out)
        files = "1 mesh or texture is" if count == 1 else f"{count} meshes or textures are"
        return [f"{files} left out, with no pictures and no collision of them ({said})"]


def _listed(names: list[str], limit: int = 4) -> str:
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


def _unreadable(path: Path) -> str:
    """Return why MuJoCo cannot read a file: empty where it may, or that it is text."""
    if not path.is_file():
        return "missing"
    if path.suffix.lower() != ".stl":
        return ""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_STL_HEADER)
    if head.startswith(b"version https://git-lfs"):
        return "a pointer to Git LFS, not a mesh"
    if len(head) < _STL_HEADER:
        return _TEXT if head.startswith(b"solid") else "not a mesh"
    faces = struct.unpack("<I", head[-4:])[0]
    if size != _STL_HEADER + _STL_FACE * faces and head.lstrip().startswith(b"solid"):
        return _TEXT
    return f"more than {MOST_FACES:,} faces" if faces > MOST_FACES else ""


def _convert(mesh: Any, path: Path) -> str:
    """Have a mesh's vertices and faces from a file that MuJoCo does not read; return why not."""
    try:
        import trimesh
    except ImportError:
        return f"{path.suffix} needs the package trimesh: pip install 'rmrc[urdf]'"
    try:
        found = trimesh.load(path, force="mesh", process=False)
        points, faces = np.asarray(found.vertices), np.asarray(found.faces)  # pyright: ignore
    except Exception as failure:  # trimesh and the readers that it calls raise what they like
        return f"cannot be read ({type(failure).__name__})"
    if not len(faces):
        return "no faces"
    mesh.uservert, mesh.userface = points.ravel().tolist(), faces.ravel().tolist()
    mesh.name, mesh.file = mesh.name or path.stem, ""
    return ""
