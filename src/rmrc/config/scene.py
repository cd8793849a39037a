"""The scene of a configuration: a file, a mapping that says more, or a model built in Python."""

from typing import Annotated, Any, Literal

import mujoco
from pydantic import Field, InstanceOf, PlainSerializer, model_validator
from pydantic.json_schema import SkipJsonSchema

from rmrc.text.base import Model
from rmrc.text.source import Attachment, Base, Source


class SceneFile(Model):
    """A model file, and how it is read."""

    file: str
    """A MJCF, URDF or xacro file, menagerie:NAME[/ENTRY] or robot_descriptions:NAME."""
    arguments: dict[str, str | bool | int | float] = Field(default={})
    """Arguments of a xacro, by name."""
    packages: dict[str, str] = Field(default={})
    """Where `package://NAME` leads, by name; the folders above the file, ROS_PACKAGE_PATH and
    AMENT_PREFIX_PATH are looked at too."""
    base: Base | None = None
    """`floating`: the root gets a free joint; `fixed`: it has none. As the file says by default."""
    meshes: Literal["auto", "off"] = "auto"
    """`auto`: those that cannot be had are left out, with a notice; `off`: all are."""

    def source(self) -> Source:
        """Return the same, as the model's reader takes it."""
        return Source(
            self.file,
            tuple((name, _text(value)) for name, value in self.arguments.items()),
            tuple(self.packages.items()),
            self.base,
            self.meshes,
        )


class Mount(Model):
    """Where a model is attached: a site or a body, by name."""

    site: str | None = None
    """Name of a site."""
    body: str | None = None
    """Name of a body."""

    @model_validator(mode="after")
    def _exactly_one(self) -> "Mount":
        if (self.site is None) == (self.body is None):
            raise ValueError("name one of site and body, as in {site: attachment_site}")
        return self


class AttachModel(SceneFile):
    """A further model, attached to the scene's: at its own `home`, else its qpos0."""

    to: Mount
    """What it hangs on."""
    prefix: str = ""
    """What its names begin with, so that they differ from the scene's."""

    def attachment(self) -> Attachment:
        """Return the same, as the model's reader takes it."""
        kind = "site" if self.to.site is not None else "body"
        return Attachment(self.source(), kind, getattr(self.to, kind), self.prefix)


class SceneModel(SceneFile):
    """A scene that says more than its file."""

    attach: tuple[AttachModel, ...] = ()
    """Further models, such as a gripper."""

    def source(self) -> Source:
        """Return the same, as the model's reader takes it."""
        own = super().source()
        attached = tuple(item.attachment() for item in self.attach)
        return Source(own.file, own.arguments, own.packages, own.base, own.meshes, attached)


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _called(model: Any) -> str:
    return f"<a {type(model).__name__} built in Python>"


Built = Annotated[
    InstanceOf[mujoco.MjModel] | InstanceOf[mujoco.MjSpec],
    SkipJsonSchema(),  # pyright: ignore[reportCallIssue]
    PlainSerializer(_called),
]
"""What only Python can give."""

SceneValue = str | SceneModel | Built


def source_of(scene: "SceneValue") -> Source:
    """Return what a scene is made of."""
    return scene.source() if isinstance(scene, SceneModel) else Source(scene)
