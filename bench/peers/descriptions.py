"""Robots that MuJoCo and Pinocchio read from the same URDF, without meshes.

The descriptions come from the package `example-robot-data`. What is visual and what collides is
taken out, so that no side has geoms; links that are fixed to others stay bodies of their own.
"""

import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import dataclass
from pathlib import Path

import mujoco

from peers.environments import ROBOTS


@dataclass(frozen=True)
class Robot:
    """A description, and what is made of it."""

    urdf: str
    """End of the path of the file in the package."""
    floating: bool = False
    fixed: tuple[str, ...] = ()
    """Joints that are held where they are, as those of a gripper."""


ROBOT = {
    "panda": Robot(
        "panda_description/urdf/panda.urdf", fixed=("panda_finger_joint1", "panda_finger_joint2")
    ),
    "g1": Robot("g1_description/urdf/g1_29dof_rev_1_0.urdf", floating=True),
}


def describe(name: str) -> str:
    """Return the URDF of a robot, of its links, joints and inertias alone.

    Raises:
        FileNotFoundError: If the package has not been fetched.
    """
    robot = ROBOT[name]
    wheel = next(ROBOTS.glob("*.whl"), None)
    if wheel is None:
        raise FileNotFoundError("there are no robots: python bench/peers/environments.py")
    with zipfile.ZipFile(wheel) as package:
        path = next(path for path in package.namelist() if path.endswith("/" + robot.urdf))
        root = ElementTree.fromstring(package.read(path))
    for element in [child for child in root if child.tag not in ("link", "joint")]:
        root.remove(element)
    for link in root.iter("link"):
        for part in [child for child in link if child.tag != "inertial"]:
            link.remove(part)
    for joint in root.iter("joint"):
        if joint.get("name") in robot.fixed:
            joint.set("type", "fixed")
            for part in [child for child in joint if child.tag in ("limit", "mimic")]:
                joint.remove(part)
    return ElementTree.tostring(root, encoding="unicode")


def write_robot(name: str, folder: Path) -> tuple[Path, Path]:
    """Write a robot's MJCF and URDF into a folder, and return where they are."""
    urdf, mjcf = folder / f"{name}.urdf", folder / f"{name}.xml"
    text = describe(name)
    urdf.write_text(text)
    keep = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco></robot>'
    spec = mujoco.MjSpec.from_string(text.removesuffix("</robot>") + keep)
    if ROBOT[name].floating:
        spec.worldbody.first_body().add_freejoint(name="base")
    spec.compile()
    mjcf.write_text(spec.to_xml())
    return mjcf, urdf
