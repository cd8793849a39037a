"""Scenes: a file of any format, or what Python has built, to a model of which nothing is lost."""

import copy
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from warnings import WarningMessage, catch_warnings, simplefilter

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError
from rmrc.model.keyframes import Keyframe, home_of, take_keyframes
from rmrc.model.locate import included, located
from rmrc.model.located import root_tag
from rmrc.model.meshes import Assets
from rmrc.model.offsets import add_sites, place_sites
from rmrc.model.packages import Packages
from rmrc.model.repair import Repairs, name_all
from rmrc.model.urdf import Description, read_urdf
from rmrc.model.xacro import expand, is_xacro
from rmrc.text.source import Attachment, Offset, Source

Array = NDArray[np.float64]

FLOATING_BASE = "floating_base"
"""The joint that `base: floating` adds."""

_FREE = mujoco.mjtJoint.mjJNT_FREE


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled model, and what its file says that MuJoCo has no place for."""

    model: mujoco.MjModel
    velocity: Mapping[str, float] = field(default_factory=dict)
    """Velocity limits of the file by joint, rad/s or m/s."""
    rest: Array = field(default_factory=lambda: np.zeros(0))
    """qpos0 (nq,), with what is attached at its own `home`."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Why each mesh or texture is left out, by the name of its file."""
    notices: tuple[str, ...] = ()
    """What a user should know of how it was read."""

    def copy(self) -> "Scene":
        """Return the same with a model of its own."""
        return Scene(
            copy.copy(self.model), self.velocity, self.rest.copy(), self.left_out, self.notices
        )


def load_scene(source: Source | str, root: Path, offsets: tuple[Offset, ...] = ()) -> Scene:
    """Return a scene, compiled.

    Args:
        source: What it is made of; a text is its file.
        root: The folder that relative paths refer to.
        offsets: Frames that are displaced from those of the model; each becomes a site.

    Raises:
        ModelError: If there is no such file or robot, or it does not compile.
    """
    source = Source(source) if isinstance(source, str) else source
    if isinstance(source.file, mujoco.MjModel):
        return _of_model(source, offsets)
    if not _cacheable(source):
        return _compiled(source, root, offsets)
    return _cached(source, root, offsets, _stamp(source, root)).copy()


def _of_model(source: Source, offsets: tuple[Offset, ...]) -> Scene:
    if offsets or source.attach or source.base is not None:
        raise ModelError(
            "an MjModel is compiled already: a frame's `offset`, `attach` and `base` need the "
            "MjSpec, its XML or its file"
        )
    assert isinstance(source.file, mujoco.MjModel)
    model = copy.copy(source.file)
    return Scene(model, rest=model.qpos0.copy())


def _cacheable(source: Source) -> bool:
    return isinstance(source.file, str) and all(_cacheable(part.source) for part in source.attach)


def _is_xml(source: Source) -> bool:
    return isinstance(source.file, str) and source.file.lstrip().startswith("<")


def _stamp(source: Source, root: Path) -> tuple[int, ...]:
    """Return when the files of a scene were changed, those that they include among them."""
    parts = (stamp for part in source.attach for stamp in _stamp(part.source, root))
    own = [] if _is_xml(source) else included(located(source, root)[1])
    return (*(path.stat().st_mtime_ns for path in own), *parts)


@lru_cache(maxsize=8)
def _cached(
    source: Source, root: Path, offsets: tuple[Offset, ...], stamp: tuple[int, ...]
) -> Scene:
    """Compile a scene once for each version of its files."""
    return _compiled(source, root, offsets)


@dataclass
class _Part:
    """A spec that is ready to be compiled, or to be attached to another."""

    spec: mujoco.MjSpec
    name: str
    said: Description
    assets: Assets
    notices: list[str]
    keyframes: list[Keyframe] = field(default_factory=list)
    """Those that were taken out of it, where something is attached."""
    rest: list[Keyframe] = field(default_factory=list)
    """Where what is attached stands."""
    left_out: dict[str, str] = field(default_factory=dict)


def _compiled(source: Source, root: Path, offsets: tuple[Offset, ...]) -> Scene:
    part = _prepared(source, root)
    spec, repairs = part.spec, Repairs(part.assets)
    add_sites(spec, offsets)
    for key in part.keyframes:
        spec.add_key(name=key.name, time=key.time)
    with _warnings(part.notices), _explained(part.name):
        model = repairs.compile()
    for name, value in part.said.locked.items():
        joint = model.joint(name)
        joint.range, joint.limited = value, 1
    rest = model.qpos0.copy()
    for key in part.rest:
        for name, value in key.qpos.items():
            first = int(model.joint(name).qposadr[0])
            rest[first : first + len(value)] = value
    for number, key in enumerate(part.keyframes):
        model.key_qpos[number] = rest
        for over in (*part.rest, key):
            over.write(model, number)
    place_sites(model, offsets)
    left_out = part.left_out | part.assets.left_out
    notices = [*part.notices, *repairs.notices()]
    part.assets.left_out = left_out
    return Scene(model, part.said.velocity, rest, left_out, (*part.assets.notices(), *notices))


def _prepared(source: Source, root: Path) -> _Part:
    """Return the spec of a scene, with all that is attached to it."""
    part = _read(source, root)
    _set_base(part, source)
    name_all(part.spec)
    part.assets.settle(source.meshes == "auto")
    if source.attach:
        _name_actuators(part.spec)
        part.keyframes = take_keyframes(part.spec)
        for attachment in source.attach:
            _attach(part, attachment, root)
    return part


def _read(source: Source, root: Path) -> _Part:
    if isinstance(source.file, mujoco.MjSpec):
        return _part(source.file.copy(), "the MjSpec")
    if _is_xml(source):
        assert isinstance(source.file, str)
        return _of_text(source.file.encode(), "the XML text", root / "scene.xml", source, root)
    source, path = located(source, root)
    if path.suffix != ".xacro" and root_tag(path) != "robot":
        heard: list[str] = []
        with _warnings(heard), _explained(path.name):
            part = _part(mujoco.MjSpec.from_file(str(path)), path.name)
        part.notices += heard
        return part
    return _of_text(path.read_bytes(), path.name, path, source, root)


def _part(spec: mujoco.MjSpec, name: str, said: Description | None = None) -> _Part:
    said = said or Description()
    return _Part(spec, name, said, Assets(spec, said.meshes), said.notices)


def _of_text(text: bytes, name: str, path: Path, source: Source, root: Path) -> _Part:
    """Return the spec of a text: MJCF, URDF or xacro."""
    packages = Packages({key: root / value for key, value in source.packages}, path)
    if is_xacro(path, text):
        text = expand(path, dict(source.arguments), packages).encode()
    elif source.arguments:
        raise ModelError(f"scene '{name}' takes no `arguments`: it is no xacro")
    if not re.search(rb"<robot[\s>/]", text):
        with _explained(name):
            spec = mujoco.MjSpec.from_string(text.decode("utf-8", "replace"))
        spec.modelfiledir = str(path.parent)
        return _part(spec, name)
    said = read_urdf(text, name, packages)
    with _warnings(said.notices), _explained(name):
        spec = mujoco.MjSpec.from_string(said.text)
    part = _part(spec, name, said)
    for mimic in said.mimics:
        spec.add_equality(
            name=mimic.name,
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=mimic.joint,
            name2=mimic.leader,
            data=_padded(mimic.offset, mimic.multiplier),
        )
    for floating in said.floating:
        body, quaternion = spec.body(floating.link), np.empty(4)
        mujoco.mju_mat2Quat(quaternion, floating.transform[:3, :3].ravel())
        body.pos, body.quat = floating.transform[:3, 3], quaternion
        body.add_freejoint(name=floating.joint)
    return part


def _padded(*coefficients: float) -> list[float]:
    """Return numbers as the data of an equality constraint."""
    return [*coefficients, *[0.0] * (mujoco.mjNEQDATA - len(coefficients))]


def _set_base(part: _Part, source: Source) -> None:
    """Have the root float, or not, as the scene asks."""
    if source.base is None:
        return
    roots = [body for body in part.spec.worldbody.bodies if not body.mocap]
    free = [joint for body in roots for joint in body.joints if joint.type == _FREE]
    if source.base == "fixed":
        for joint in free:
            part.spec.delete(joint)
    elif not free:
        if len(roots) != 1 or list(roots[0].joints):
            raise ModelError(
                f"scene '{part.name}' has no single root that could float: the world carries "
                f"{', '.join(body.name or 'a body without a name' for body in roots) or 'nothing'}"
            )
        roots[0].add_freejoint(name=FLOATING_BASE)


def _name_actuators(spec: mujoco.MjSpec) -> None:
    for number, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or f"actuator{number}"


def _attach(part: _Part, attachment: Attachment, root: Path) -> None:
    """Attach a further model, at its own home, and remember what is known of it."""
    child = _prepared(attachment.source, root)
    _name_actuators(child.spec)
    keyframes = child.keyframes or take_keyframes(child.spec)
    prefix = attachment.prefix
    for body in child.spec.worldbody.bodies:
        for joint in [joint for joint in body.joints if joint.type == _FREE]:
            child.spec.delete(joint)
    joints = {joint.name for joint in child.spec.joints}
    holder = getattr(part.spec, attachment.kind)(attachment.name)
    if holder is None:
        known = [item.name for item in getattr(part.spec, f"{_PLURAL[attachment.kind]}")]
        raise ModelError(
            f"there is no {attachment.kind} '{attachment.name}' in '{part.name}' to attach "
            f"'{child.name}' to; there is: {', '.join(filter(None, known[:12]))}"
        )
    try:
        if attachment.kind == "site":
            part.spec.attach(child.spec, prefix=prefix, site=holder)
        else:
            part.spec.attach(child.spec, prefix=prefix, frame=holder.add_frame())
    except ValueError as failure:
        reason = " ".join(str(failure).split())
        raise ModelError(
            f"'{child.name}' cannot be attached to '{attachment.name}': {reason} "
            "(a `prefix` of its own keeps names apart)"
        ) from None
    home = home_of(keyframes)
    if home is not None:
        home.qpos = {name: value for name, value in home.qpos.items() if name in joints}
        home.qvel, home.mocap = {}, {}
        part.rest.append(home.named(prefix))
    part.rest += [key.named(prefix) for key in child.rest]
    part.said.velocity |= {f"{prefix}{n}": v for n, v in child.said.velocity.items()}
    part.said.locked |= {f"{prefix}{n}": v for n, v in child.said.locked.items()}
    part.left_out |= child.left_out | child.assets.left_out
    part.notices += child.notices


_PLURAL = {"site": "sites", "body": "bodies", "geom": "geoms"}
_LINE = re.compile(r"\s*Element '([^']*)', line (\d+)")


@contextmanager
def _explained(name: str) -> Iterator[None]:
    """Say what MuJoCo found with the file and the line."""
    try:
        yield
    except ModelError:
        raise
    except Exception as failure:  # MuJoCo raises ValueError, and its plugins what they like
        text = str(failure)
        line = _LINE.search(text)
        where = f"{name}:{line[2]}: <{line[1]}>" if line else f"scene '{name}'"
        reason = " ".join(_LINE.sub("", text).split())
        raise ModelError(f"{where} does not compile: {reason}") from None


@contextmanager
def _warnings(said: list[str]) -> Iterator[None]:
    """Have MuJoCo's warnings as notices, which would go to the terminal and into a file."""
    before, heard = mujoco.get_mju_user_warning(), []
    caught: list[WarningMessage] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        with catch_warnings(record=True) as heeded:
            caught = heeded
            simplefilter("always")
            yield
    finally:
        mujoco.set_mju_user_warning(before)
        heard += [str(warning.message) for warning in caught]
        said += [" ".join(text.split()) for text in dict.fromkeys(heard)]
