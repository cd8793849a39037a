"""The limits of a configuration: of the joints, of frames, and between geoms."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from rmrc.text.annotations import NameOf
from rmrc.text.base import (
    Direction,
    FrameName,
    JointName,
    Model,
    Name,
    NonNegative,
    Number,
    Positive,
    Share,
    Subtree,
)

Off = Literal["off"]


class PositionLimit(Model):
    """Joints stay inside their ranges: the model's, or those given here by joint name."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[JointName, tuple[Number, Number]] = Field(init=False)  # pyright: ignore

    margin: NonNegative = 0.0
    """Distance kept from each end of the range, rad or m."""
    gain: Share = 0.95
    """Share g of the remaining distance that a step may use."""

    @property
    def named(self) -> dict[str, tuple[float, float]]:
        """The ranges of the joints that are named, in place of the model's."""
        return dict(self.__pydantic_extra__ or {})

    @model_validator(mode="after")
    def _ordered(self) -> "PositionLimit":
        for name, (low, high) in self.named.items():
            if low > high:
                raise ValueError(
                    f"the range of '{name}' is [lower, upper], and {low:g} is above {high:g}"
                )
        return self


class PerJoint(Model):
    """A limit for each joint: a default, and others by joint name."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[JointName, Positive] = Field(init=False)  # pyright: ignore

    default: Positive | None = None
    """For every joint that is not named."""

    @property
    def named(self) -> dict[str, float]:
        """The limits of the joints that are named."""
        return dict(self.__pydantic_extra__ or {})


class BaseLimit(Model):
    """Speed of floating bases, along and about each of their axes."""

    linear: Positive | None = None
    """Largest speed along each axis of the world, m/s."""
    angular: Positive | None = None
    """Largest rate about each axis of the base, rad/s."""


class SpeedLimit(Model):
    """Speed of a task's frame: the norm of its velocity."""

    linear: Positive | None = None
    """Largest speed of the frame's origin, m/s."""
    angular: Positive | None = None
    """Largest angular speed, rad/s."""

    @model_validator(mode="after")
    def _some(self) -> "SpeedLimit":
        if self.linear is None and self.angular is None:
            raise ValueError("give linear, angular or both, as in {linear: 0.25}")
        return self


class WorkspacePlane(Model):
    """A plane that the origin of a frame stays in front of: nᵀp ≥ offset."""

    frame: FrameName
    """The frame."""
    normal: Direction
    """Normal n of the plane, towards the allowed side, in the world."""
    offset: Number
    """Distance of the plane from the world's origin along n, m."""
    gain: Share = 0.9
    """Share of the free distance that a step may use."""


GeomName = Annotated[str, NameOf("geom or body")]
Part = str | Subtree
"""A geom, a body, a group, or all that hangs on a body."""


class CollisionLimit(Model):
    """Pairs of geoms stay apart."""

    pairs: tuple[tuple[Part, Part], ...] | Literal["all"] = "all"
    """Pairs of geoms, bodies (all their geoms that collide), subtrees, as {subtree: left_base}, or
    `groups`; `all` is every pair that
    MuJoCo would let collide and that the joints move relative to each other. Of `groups`, bodies
    and their parents and what the scene excludes are left out; pairs that are named stay."""
    exclude: tuple[tuple[Part, Part], ...] = ()
    """Pairs, named as in `pairs`, that are left out."""
    groups: dict[Name, Annotated[tuple[GeomName | Subtree, ...], Field(min_length=1)]] = Field(
        default={}
    )
    """Geoms, bodies and subtrees under a name of their own."""
    d_min: NonNegative = 0.01
    """Least distance, m."""
    detect: Positive = 0.05
    """Distance from which a pair limits the motion, m."""
    gain: Share = 0.9
    """Share ξ·dt of the free distance that a step may use."""
    push: Positive = 0.1
    """Speed at which a pair closer than `d_min` is pushed apart, at most, m/s."""

    @model_validator(mode="after")
    def _ordered(self) -> "CollisionLimit":
        if self.detect <= self.d_min:
            raise ValueError(
                f"detect must be above d_min, and {self.detect:g} is not above {self.d_min:g}"
            )
        return self


class LimitsModel(Model):
    """The limits; `off` removes one that is on by default."""

    position: PositionLimit | Off = PositionLimit()
    """Position, from the model's ranges; on by default."""
    velocity: PerJoint | Off = PerJoint()
    """Velocity in rad/s or m/s; by default π rad/s and 1 m/s."""
    acceleration: PerJoint | Off = "off"
    """Acceleration in rad/s² or m/s²; off by default."""
    jerk: PerJoint | Off = "off"
    """Jerk in rad/s³ or m/s³, a limit on the change of acceleration; off by default."""
    base: BaseLimit | Off = "off"
    """Speed of a floating base; off by default."""
    speed: dict[Name, SpeedLimit] = Field(default={})
    """Speed of the frames of `frame` tasks, by task."""
    workspace: tuple[WorkspacePlane, ...] = ()
    """Planes that frames stay in front of."""
    collision: CollisionLimit | Off = "off"
    """Distances between geoms; off by default."""
