"""Random robots and what stands about them, as MJCF: trees of all joints, at all scales."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from soaking.drawer import Array, Drawer, Generator

MOST_DOFS = 40
SMALLEST, LARGEST = 1e-3, 1e3
"""Lengths of a robot's links beside those of an arm: millimetres and kilometres."""
LEAST_INERTIA = 1e-9
"""kg m²; MuJoCo refuses bodies with less than 1e-15."""
ATTEMPTS = 50
"""Trees that are drawn before one has to compile: joints of a body may not fit together."""


@dataclass
class Tree:
    """A scene that was drawn, and the names in it."""

    scale: float
    """What lengths are multiplied by."""
    xml: str = ""
    bodies: list[str] = field(default_factory=list)
    """Of the robot, parents first."""
    frames: list[dict[str, str]] = field(default_factory=list)
    """What of the robot a task can move."""
    joints: dict[str, list[str]] = field(default_factory=dict)
    """Of the robot, by type."""
    geoms: list[str] = field(default_factory=list)
    """Of the robot."""
    surroundings: list[str] = field(default_factory=list)
    """Geoms that are not the robot's."""
    objects: list[str] = field(default_factory=list)
    """Bodies that nothing drives."""
    equalities: list[str] = field(default_factory=list)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled scene."""
        return mujoco.MjModel.from_xml_string(self.xml)

    @property
    def scalars(self) -> list[str]:
        """The hinges and slides of the robot."""
        return [*self.joints.get("hinge", []), *self.joints.get("slide", [])]

    def __str__(self) -> str:
        kinds = ", ".join(f"{len(names)} {kind}" for kind, names in self.joints.items())
        return (
            f"tree of {kinds}; scale {self.scale:.3g}, nv {self.model.nv}, "
            f"{len(self.objects)} objects, {len(self.equalities)} equalities"
        )


def draw_tree(rng: Generator) -> Tree:
    """Return a random scene that compiles."""
    drawer = Drawer(rng)
    for _ in range(ATTEMPTS):
        tree = _Builder(drawer).build()
        try:
            return tree if tree.model.nv else draw_tree(rng)
        except ValueError:
            continue
    raise RuntimeError("no random tree compiles")


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


class _Builder:
    """Grows one scene."""

    def __init__(self, drawer: Drawer):
        self._drawer, self._rng = drawer, drawer.rng
        self._scale = drawer.among(1.0, drawer.between(SMALLEST, LARGEST))
        self._tree = Tree(self._scale)
        self._root = Xml.Element("mujoco")
        Xml.SubElement(
            self._root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false"
        )
        self._option = Xml.SubElement(self._root, "option")
        self._world = Xml.SubElement(self._root, "worldbody")
        self._actuators = Xml.SubElement(self._root, "actuator")
        self._equality = Xml.SubElement(self._root, "equality")
        self._tendon = Xml.SubElement(self._root, "tendon")
        self._contact = Xml.SubElement(self._root, "contact")
        self._bodies: dict[str, Xml.Element] = {}
        self._movers = 0

    def build(self) -> Tree:
        """Return the scene."""
        drawer = self._drawer
        if drawer.chance(0.2):
            self._option.set("jacobian", drawer.among("sparse", "dense"))
        self._robot()
        self._stand_about()
        if drawer.chance(0.4):
            self._add_objects()
        if drawer.chance(0.25):
            self._add_equalities()
        self._drive()
        self._tree.xml = Xml.tostring(self._root, encoding="unicode")
        if drawer.chance(0.05 if self._tree.equalities else 0.4):  # which it would leave open
            self._add_home()
        return self._tree

    def _length(self, low: float = 0.05, high: float = 0.5) -> float:
        return self._scale * self._rng.uniform(low, high)

    def _vector(self, low: float = 0.05, high: float = 0.5) -> Array:
        return self._drawer.direction() * self._length(low, high)

    def _robot(self) -> None:
        drawer, tree = self._drawer, self._tree
        wanted = round(drawer.between(1.0, MOST_DOFS))
        straight, like = drawer.among(0.5, 0.9, 1.0), drawer.among("hinge", "any", "any")
        parent, count = self._base(), 0
        if parent is not self._world and parent.find("freejoint") is not None:
            count = 6
        while count < wanted or not tree.bodies:
            body = self._link(parent)
            count += self._joints(body, wanted - count, like)
            follow = drawer.chance(straight) or len(tree.bodies) < 2
            parent = body if follow else self._bodies[drawer.among(*tree.bodies)]

    def _base(self) -> Xml.Element:
        """Return what the first link hangs on: the world, a floating base, or what is moved."""
        kind = self._drawer.among(*["world"] * 7, "free", "free", "mocap")
        if kind == "world":
            return self._world
        if kind == "mocap":
            body = Xml.SubElement(self._world, "body", name="mount", mocap="true")
            body.set("pos", _text(self._vector()))
            return body
        body = self._link(self._world)
        Xml.SubElement(body, "freejoint", name="base")
        self._tree.joints["free"] = ["base"]
        return body

    def _link(self, parent: Xml.Element) -> Xml.Element:
        """Add a body of the robot with its geoms and a site."""
        drawer, tree = self._drawer, self._tree
        number = len(tree.bodies)
        name, end = f"link{number}", self._vector()
        body = Xml.SubElement(parent, "body", name=name, pos=_text(self._vector(0.0, 0.6)))
        if drawer.chance(0.5):
            body.set("quat", _text(drawer.quaternion()))
        self._weigh(body)
        for k in range(drawer.among(0, 1, 1, 1, 2)):
            geom = f"{name}_geom{k}"
            self._shape(body, geom, end)
            tree.geoms.append(geom)
        Xml.SubElement(body, "site", name=f"{name}_site", pos=_text(end))
        tree.bodies.append(name)
        tree.frames += [{"site": f"{name}_site"}, {"body": name}]
        self._bodies[name] = body
        return body

    def _weigh(self, body: Xml.Element) -> None:
        mass = self._drawer.between(0.1, 10.0)
        inertia = max(mass * self._length(0.05, 0.2) ** 2, LEAST_INERTIA)
        Xml.SubElement(
            body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=_text([inertia] * 3)
        )

    def _shape(self, body: Xml.Element, name: str, end: Array, collides: float = 0.9) -> None:
        """Add a geom of any type but a plane."""
        drawer, rng = self._drawer, self._rng
        kind = drawer.among("sphere", "capsule", "capsule", "box", "cylinder", "ellipsoid")
        geom = Xml.SubElement(body, "geom", name=name, type=kind)
        sizes = self._scale * np.exp(rng.uniform(np.log(0.01), np.log(0.12), 3))
        if kind in ("capsule", "cylinder") and drawer.chance(0.6):
            geom.set("fromto", _text([*(0.1 * end), *(0.9 * end)]))
            geom.set("size", _text(sizes[:1]))
        else:
            count = {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)
            geom.set("size", _text(sizes[:count]))
            geom.set("pos", _text(end * rng.uniform()))
            geom.set("quat", _text(drawer.quaternion()))
        if not drawer.chance(collides):
            geom.set("contype", drawer.among("0", "2"))
            geom.set("conaffinity", "0")

    def _joints(self, body: Xml.Element, most: int, like: str) -> int:
        """Give a body one to three joints; return how many dofs they have."""
        drawer, joints, count = self._drawer, self._tree.joints, 0
        for _ in range(drawer.among(1, 1, 1, 2, 3)):
            kind = "hinge" if like == "hinge" else drawer.among("hinge", "hinge", "slide", "ball")
            kind = "hinge" if kind == "ball" and most - count < 3 else kind
            if count and (count >= most or kind == "ball"):
                break
            known = joints.setdefault(kind, [])
            name = f"{kind}{len(known)}"
            joint = Xml.SubElement(body, "joint", name=name, type=kind)
            known.append(name)
            if kind != "ball":
                joint.set("axis", _text(drawer.among(drawer.direction(), *np.eye(3))))
            if kind != "slide" and drawer.chance(0.5):
                joint.set("pos", _text(self._vector(0.0, 0.2)))
            if (ends := self._range(kind)) is not None:
                joint.set("range", _text(ends))
            count += 3 if kind == "ball" else 1
            if kind == "ball":
                break
        return count

    def _range(self, kind: str) -> Array | None:
        """Return the ends of a joint's range: none, usual, tiny, aside of zero or of many turns."""
        drawer, rng = self._drawer, self._rng
        if drawer.chance(0.35):
            return None
        if kind == "ball":
            return np.array([0.0, drawer.among(rng.uniform(0.05, 3.3), 0.5)])
        low, high = rng.uniform(-3.0, -0.1), rng.uniform(0.1, 3.0)
        ends = drawer.among(
            *[(low, high)] * 6,
            (low, low + 1e-9),
            (high, high + 2.0),
            (-9.0 * high, 7.0 * high),
            (-200.0, 300.0),
        )
        return np.array(ends) * (0.3 * self._scale if kind == "slide" else 1.0)

    def _stand_about(self) -> None:
        """Put floors, posts and movers about the robot."""
        drawer, tree = self._drawer, self._tree
        if drawer.chance(0.4):
            floor = Xml.SubElement(self._world, "geom", name="floor", type="plane", size="1 1 1")
            floor.set("pos", _text([0.0, 0.0, -self._length(0.1, 1.0)]))
            if drawer.chance(0.2):
                floor.set("quat", _text(drawer.quaternion()))
            tree.surroundings.append("floor")
        for k in range(drawer.among(0, 1, 2)):
            post = Xml.SubElement(self._world, "body", name=f"post{k}")
            post.set("pos", _text(self._vector(0.3, 1.5)))
            self._shape(post, f"post{k}_geom", self._vector())
            tree.surroundings.append(f"post{k}_geom")
        for k in range(drawer.among(0, 1, 1, 2)):
            mover = Xml.SubElement(self._world, "body", name=f"mover{k}", mocap="true")
            mover.set("pos", _text(self._vector(0.5, 2.0)))
            self._shape(mover, f"mover{k}_geom", self._vector())
            tree.surroundings.append(f"mover{k}_geom")

    def _add_objects(self) -> None:
        """Put cups that lie free, and doors on hinges, about the robot."""
        drawer, tree = self._drawer, self._tree
        for k in range(drawer.among(1, 1, 2)):
            name, door = f"object{k}", drawer.chance(0.4)
            body = Xml.SubElement(self._world, "body", name=name, pos=_text(self._vector(0.3, 1.5)))
            self._weigh(body)
            if door:
                joint = Xml.SubElement(body, "joint", name=f"{name}_hinge", axis="0 0 1")
                joint.set("range", "-1.5 1.5")
            else:
                Xml.SubElement(body, "freejoint", name=f"{name}_free")
            self._shape(body, f"{name}_geom", self._vector())
            tree.surroundings.append(f"{name}_geom")
            if door and drawer.chance(0.5):
                handle = Xml.SubElement(
                    body, "body", name=f"{name}_handle", pos=_text(self._vector())
                )
                self._weigh(handle)
                joint = Xml.SubElement(handle, "joint", name=f"{name}_slide", type="slide")
                joint.set("range", _text([0.0, self._length()]))
                self._shape(handle, f"{name}_handle_geom", self._vector())
                tree.surroundings.append(f"{name}_handle_geom")
            tree.objects.append(name)

    def _add_equalities(self) -> None:
        drawer, rng, tree = self._drawer, self._rng, self._tree
        for k in range(drawer.among(1, 1, 2, 4)):
            name, kind = f"equality{k}", drawer.among("connect", "weld", "joint", "joint", "tendon")
            if kind in ("connect", "weld"):
                first, second = drawer.among(*tree.bodies), drawer.among(*tree.bodies, None)
                if first == second:
                    continue
                found = Xml.SubElement(self._equality, kind, name=name, body1=first)
                found.set("anchor", _text(self._vector(0.0, 0.3)))
                if second:
                    found.set("body2", second)
            else:
                scalars = [drawer.among(*names) for names in [tree.scalars] * 2 if names]
                if len(set(scalars)) < 2:
                    continue
                if kind == "joint":
                    found = Xml.SubElement(self._equality, "joint", name=name, joint1=scalars[0])
                    found.set("joint2", scalars[1])
                    found.set("polycoef", _text([0.0, rng.uniform(-2.0, 2.0), 0.0, 0.0, 0.0]))
                else:
                    tendon = Xml.SubElement(self._tendon, "fixed", name=f"tendon{k}")
                    for scalar in scalars:
                        coefficient = repr(float(rng.uniform(-2.0, 2.0)))
                        Xml.SubElement(tendon, "joint", joint=scalar, coef=coefficient)
                    Xml.SubElement(self._equality, "tendon", name=name, tendon1=f"tendon{k}")
            tree.equalities.append(name)

    def _drive(self) -> None:
        """Put actuators on joints of the robot: on some of each of its trees, if there are objects.

        Without objects there may be none at all.
        """
        drawer, tree = self._drawer, self._tree
        driven = [name for kind, names in tree.joints.items() if kind != "free" for name in names]
        if not tree.objects and drawer.chance(0.4):
            return
        for k, name in enumerate(driven):
            if k and not drawer.chance(0.6):
                continue
            kind = "motor"
            if name in tree.scalars:
                kind = drawer.among("motor", "motor", "position", "velocity")
            actuator = Xml.SubElement(self._actuators, kind, joint=name)
            if kind != "motor" and drawer.chance(0.3):
                ends = np.array([-1.0, 1.5]) * drawer.among(0.5, 1.0, 3.0)
                actuator.set("ctrlrange", _text(ends * (self._scale if "slide" in name else 1.0)))

    def _add_home(self) -> None:
        """Have a keyframe `home` with another configuration and other poses of what is moved."""
        try:
            model = mujoco.MjModel.from_xml_string(self._tree.xml)
        except ValueError:
            return  # which is found, and drawn again
        q = model.qpos0.copy()
        rates = self._rng.uniform(-1.0, 1.0, model.nv) * self._drawer.among(0.1, 0.5, 2.0)
        for joint in range(model.njnt):
            first = model.jnt_dofadr[joint]
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                rates[first] *= 0.3 * self._scale
            elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                rates[first : first + 3] *= self._scale
        mujoco.mj_integratePos(model, q, rates, 1.0)
        key = Xml.SubElement(Xml.SubElement(self._root, "keyframe"), "key", name="home")
        key.set("qpos", _text(q))
        if model.nmocap:
            places = np.array([self._vector(0.3, 2.0) for _ in range(model.nmocap)])
            key.set("mpos", _text(places.ravel()))
        self._tree.xml = Xml.tostring(self._root, encoding="unicode")
