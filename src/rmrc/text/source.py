"""What a scene is made of, before anything is read."""

from dataclasses import dataclass
from typing import Literal

import mujoco

Base = Literal["fixed", "floating"]
FrameKind = Literal["site", "body", "geom"]
Vector = tuple[float, ...]


@dataclass(frozen=True)
class Attachment:
    """A further model, and where it is attached."""

    source: "Source"
    kind: FrameKind
    name: str
    """The site or body that it hangs on."""
    prefix: str = ""
    """What its names begin with."""


@dataclass(frozen=True)
class Source:
    """A scene as a configuration or a program names it."""

    file: str | mujoco.MjModel | mujoco.MjSpec
    """A path, menagerie:NAME[/ENTRY], robot_descriptions:NAME, an XML text, or MuJoCo's object."""
    arguments: tuple[tuple[str, str], ...] = ()
    """Arguments of a xacro."""
    packages: tuple[tuple[str, str], ...] = ()
    """Folders of packages by name."""
    base: Base | None = None
    """What the root is; by default as the file says."""
    meshes: Literal["auto", "off"] = "auto"
    attach: tuple[Attachment, ...] = ()


@dataclass(frozen=True)
class Offset:
    """A frame that is displaced from one of the model's."""

    kind: FrameKind | None
    """None where the name says it."""
    frame: str
    position: Vector
    quaternion: Vector

    @property
    def name(self) -> str:
        """The name of the site that stands for it."""
        shift = ", ".join(f"{value:g}" for value in self.position)
        turn = ", ".join(f"{value:.6g}" for value in self.quaternion)
        return f"{self.kind or 'frame'} {self.frame} + [{shift}; {turn}]"
