"""URDF for MuJoCo: what it cannot read is taken out of the text, what it drops is kept beside it.

MuJoCo's reader has no packages, no floating joint below another link, no velocity limits, and fuses
fixed links away. Here the text is edited before MuJoCo reads it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.model.located import Located, first, numbers, parse
from rmrc.model.packages import Packages

Array = NDArray[np.float64]

_SCALAR = ("revolute", "continuous", "prismatic")
_TYPES = (*_SCALAR, "fixed", "floating", "planar", "spherical", "ball")
_PER_LINK = ("inertial",)
_PER_JOINT = ("origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration")
_COMPILER = {"fusestatic": "false", "strippath": "false", "discardvisual": "false"}


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = offset + multiplier · q of the leader."""

    joint: str
    leader: str
    """Empty where the leader is fixed."""
    multiplier: float
    offset: float

    @property
    def name(self) -> str:
        """What messages call it, and the name of its equality constraint."""
        return f"{self.joint} mimics {self.leader}" if self.leader else f"{self.joint} stands"


@dataclass(frozen=True)
class Floating:
    """A link that a joint lets float in the world."""

    link: str
    joint: str
    transform: Array
    """Its pose (4, 4) in the world at zero."""


@dataclass
class Description:
    """A URDF as MuJoCo can read it, and what MuJoCo would drop."""

    text: str = ""
    meshes: dict[str, Path] = field(default_factory=dict)
    """The files that stand behind the names of meshes in the text."""
    velocity: dict[str, float] = field(default_factory=dict)
    """rad/s or m/s by joint."""
    locked: dict[str, float] = field(default_factory=dict)
    """Where joints stand whose lower limit is the upper one."""
    mimics: list[Mimic] = field(default_factory=list)
    floating: list[Floating] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)


def read_urdf(text: str | bytes, name: str, packages: Packages) -> Description:
    """Return a URDF for MuJoCo.

    Args:
        text: The text.
        name: How messages call the file.
        packages: Where its meshes are.

    Raises:
        ModelError: If it is no URDF; the message has file, line and name.
    """
    return _Reader(parse(text, name), name, packages).description()


class _Reader:
    def __init__(self, root: Located, name: str, packages: Packages):
        self._root, self._file, self._packages = root, name, packages
        self._said = Description()
        self._parts: set[str] = set()
        """Names of visuals and collisions, which become geoms."""
        self._links = self._named("link")
        self._joints = self._named("joint")
        self._parents = dict(self._tree())

    def description(self) -> Description:
        """Return what was read."""
        if not self._links:
            raise ModelError(
                f"{self._file}: this robot has no <link>: it is a part that others include"
            )
        for link, element in self._links.items():
            self._keep_first("link", link, element, _PER_LINK)
            self._read_link(link, element)
        for joint, element in self._joints.items():
            self._keep_first("joint", joint, element, _PER_JOINT)
            self._read_joint(joint, element)
        self._mimic()
        self._set_compiler()
        self._said.text = ElementTree.tostring(self._root, encoding="unicode")
        return self._said

    def _where(self, kind: str, name: str) -> str:
        return f"{self._file}:{{line}}: {kind} '{name}'"

    def _fail(self, element: Located, message: str) -> ModelError:
        return ModelError(f"{self._file}:{element.line}: {message}")

    def _named(self, tag: str) -> dict[str, Located]:
        """Return the elements of a kind by name; one without a name gets one."""
        found: dict[str, Located] = {}
        for element in self._root.findall(tag):
            assert isinstance(element, Located)
            name = element.get("name") or ""
            if not name:
                child = first(element, "child")
                name = f"{'' if child is None else child.get('link')}_joint"
                if tag == "link":
                    raise self._fail(element, "a <link> has no name")
                element.set("name", name)
            if name in found:
                before = found[name].line
                raise self._fail(element, f"{tag} '{name}' is here twice: see line {before}")
            found[name] = element
        return found

    def _tree(self) -> Iterator[tuple[str, tuple[str, str]]]:
        """Yield each link that has a parent, with the parent and the joint between."""
        by: dict[str, str] = {}
        for joint, element in self._joints.items():
            ends = []
            for end in ("parent", "child"):
                named = first(element, end)
                link = None if named is None else named.get("link")
                if link is None:
                    raise self._fail(element, f"joint '{joint}' has no <{end} link=…>")
                if link not in self._links:
                    message = unknown_name("link", link, self._links)
                    raise self._fail(named or element, f"joint '{joint}': {message}")
                ends.append(link)
            parent, child = ends
            if child in by:
                message = f"link '{child}' hangs on two joints, '{by[child]}' and '{joint}'"
                raise self._fail(element, message)
            by[child] = joint
            yield child, (parent, joint)

    def _keep_first(self, kind: str, name: str, element: Located, tags: tuple[str, ...]) -> None:
        """Take out what may be there once and is there again, as other readers do."""
        for tag in tags:
            for again in element.findall(tag)[1:]:
                assert isinstance(again, Located)
                element.remove(again)
                self._said.notices.append(
                    f"{self._file}:{again.line}: {kind} '{name}' has a second <{tag}>, "
                    "which is left out"
                )

    def _read_link(self, name: str, link: Located) -> None:
        where = self._where("link", name)
        inertial = first(link, "inertial")
        if inertial is not None:
            numbers(first(inertial, "mass"), "value", (0.0,), where)
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
                numbers(first(inertial, "inertia"), key, (0.0,), where)
        for part in list(link):
            if part.tag in ("inertial", "visual", "collision"):
                self._origin(part, where)
            if part.tag not in ("visual", "collision"):
                continue
            if part.get("name", "") and part.get("name") in self._parts:
                del part.attrib["name"]  # MuJoCo would warn, and leave it out too
            self._parts.add(part.get("name", ""))
            geometry = first(part, "geometry")
            shape = None if geometry is None or not len(geometry) else geometry[0]
            if not isinstance(shape, Located) or not self._is_shape(shape, where):
                link.remove(part)

    def _is_shape(self, shape: Located, where: str) -> bool:
        """Return whether a geometry is one that MuJoCo reads; a mesh gets a name of its own."""
        if shape.tag == "mesh":
            try:
                scale = numbers(shape, "scale", (1.0, 1.0, 1.0), where)
            except ModelError as mistake:
                self._said.notices.append(f"{mistake}: the mesh is left out")
                return False
            shape.set("scale", " ".join(f"{value!r}" for value in scale))
            uri = shape.get("filename")
            if not uri or not all(scale):
                return False
            path = self._packages.resolve(uri)
            known = {file: alias for alias, file in self._said.meshes.items()}
            alias = known.get(path) or f"{len(known)}/{path.stem or 'mesh'}.stl"
            self._said.meshes[alias] = path
            shape.set("filename", alias)
            return True
        sizes = {"box": {"size": 3}, "sphere": {"radius": 1}}
        round_ones = {"cylinder": {"radius": 1, "length": 1}, "capsule": {"radius": 1, "length": 1}}
        keys = (sizes | round_ones).get(shape.tag)
        if keys is None:
            self._said.notices.append(f"a <{shape.tag}> is left out: it is no shape of MuJoCo's")
            return False
        return all(
            min(numbers(shape, key, (0.0,) * count, where)) > 0.0 for key, count in keys.items()
        )

    def _origin(self, element: ElementTree.Element, where: str) -> Array:
        """Return the transform (4, 4) of an element's origin."""
        origin, zero = first(element, "origin"), (0.0, 0.0, 0.0)
        transform = np.eye(4)
        transform[:3, 3] = numbers(origin, "xyz", zero, where)
        roll, pitch, yaw = numbers(origin, "rpy", zero, where)
        transform[:3, :3] = _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)
        return transform

    def _read_joint(self, name: str, joint: Located) -> None:
        where, kind = self._where("joint", name), joint.get("type", "")
        if kind not in _TYPES:
            raise self._fail(joint, f"joint '{name}': {unknown_name('type', kind, _TYPES)}")
        self._origin(joint, where)
        axis = numbers(first(joint, "axis"), "xyz", (1.0, 0.0, 0.0), where)
        if kind in (*_SCALAR, "planar") and np.linalg.norm(axis) < 1e-12:
            raise self._fail(joint, f"joint '{name}' has an axis of zero length")
        if kind == "floating":
            self._float(name, joint)
        elif kind in ("fixed", "spherical", "ball"):
            for limit in joint.findall("limit"):
                joint.remove(limit)  # there is no axis that it could be of
        elif kind in _SCALAR:
            self._limit(name, joint, kind, where)

    def _float(self, name: str, joint: Located) -> None:
        """Take a floating joint out: its link becomes one of the world's, and free there."""
        child, parent = joint.find("child"), joint.find("parent")
        assert child is not None
        assert parent is not None
        transform, link = self._origin(joint, self._file), parent.get("link", "")
        while link in self._parents:
            link, above = self._parents[link]
            between = self._joints[above]
            if between.get("type") != "fixed":
                message = f"joint '{name}' floats, and hangs on '{above}', which moves"
                raise self._fail(joint, message)
            transform = self._origin(between, self._file) @ transform
        self._said.floating.append(Floating(child.get("link", ""), name, transform))
        self._root.remove(joint)

    def _limit(self, name: str, joint: Located, kind: str, where: str) -> None:
        limit, safety = first(joint, "limit"), first(joint, "safety_controller")
        if limit is None:
            return
        speed, effort = (numbers(limit, key, (0.0,), where)[0] for key in ("velocity", "effort"))
        low, high = (numbers(limit, key, (0.0,), where)[0] for key in ("lower", "upper"))
        if speed > 0.0:
            self._said.velocity[name] = speed
        if effort <= 0.0:
            limit.attrib.pop("effort", None)
        if kind == "continuous":
            for key in ("lower", "upper"):
                limit.attrib.pop(key, None)
            return
        soft_low = numbers(safety, "soft_lower_limit", (low,), where)[0]
        soft_high = numbers(safety, "soft_upper_limit", (high,), where)[0]
        if low <= soft_low < soft_high <= high:
            low, high = soft_low, soft_high
        if low == high:
            self._said.locked[name] = low
        elif low > high:
            self._said.notices.append(
                f"joint '{name}' has no range: its lower limit, {low:g}, is above its upper one"
            )
        if low >= high:
            for key in ("lower", "upper"):
                limit.attrib.pop(key, None)
        else:
            limit.set("lower", repr(low))
            limit.set("upper", repr(high))

    def _mimic(self) -> None:
        """Note who follows whom, and take it out: not every MuJoCo reads it, and none names it."""
        for name, joint in self._joints.items():
            mimic, where = first(joint, "mimic"), self._where("joint", name)
            if mimic is None:
                continue
            joint.remove(mimic)
            leader = mimic.get("joint", "")
            known = self._joints.get(leader)
            multiplier = numbers(mimic, "multiplier", (1.0,), where)[0]
            offset = numbers(mimic, "offset", (0.0,), where)[0]
            if joint.get("type") not in _SCALAR:
                continue  # what does not move follows nothing
            if known is not None and known.get("type") in _SCALAR:
                self._said.mimics.append(Mimic(name, leader, multiplier, offset))
            elif known is not None and known.get("type") == "fixed":
                self._said.mimics.append(Mimic(name, "", 0.0, offset))
            else:
                message = unknown_name("axis", leader, self._joints)
                self._said.notices.append(
                    f"{self._file}:{mimic.line}: joint '{name}' mimics no other: {message}"
                )

    def _set_compiler(self) -> None:
        """Set MuJoCo's own options; others that the file sets stay."""
        extension = self._root.find("mujoco")
        if extension is None:
            extension = ElementTree.SubElement(self._root, "mujoco")
        compiler = extension.find("compiler")
        if compiler is None:
            compiler = ElementTree.SubElement(extension, "compiler")
        compiler.attrib.pop("meshdir", None)
        compiler.attrib.update(_COMPILER)


def _turn(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) about one of the axes."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[one, one] = turn[other, other] = np.cos(angle)
    turn[other, one] = np.sin(angle)
    turn[one, other] = -turn[other, one]
    return turn
