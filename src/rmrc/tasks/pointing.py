"""What the tasks share that point an axis of a frame: `look_at` and `axis_align`."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import mink
import mujoco
import numpy as np

from rmrc.model.frames import FrameHandle, resolve
from rmrc.tasks.base import Array, BendingTerm, GainedTask, HardTask, Way, weight_array
from rmrc.tasks.mink_tasks import MinkTerm
from rmrc.text.base import Direction, FrameName, NonNegative

RIGHT = math.sqrt(2.0)
"""‖d − a‖ at a right angle."""
SLOPE = math.sqrt(0.5)
"""dρ/dθ beyond a right angle, that of 2 sin(θ/2) there."""
ANTIPODE = 1e-7
"""A sine of θ, at the far side, below which rounding decides which way is the shorter."""
SIDEWAYS = (math.cos(1.0), math.sin(1.0))
"""The way taken there, in two axes at right angles to d: along none of them, for the joints of
most wrists turn about such axes, and a single one of them has to turn the frame."""


class Stretch(NamedTuple):
    """How e = ρ(θ) n changes with the unit vector d: M = ∂e/∂d = s I − μ n lᵀ.

    n = (d − a)/‖d − a‖, l is the way from d to a, s = ρ/‖d − a‖ and μ = ρ' − s cos(θ/2).
    """

    direction: Array
    """d."""
    along: Array
    """n."""
    toward: Array
    """l."""
    factor: float
    """s."""
    slope: float
    """μ."""
    half: float
    """θ/2."""

    @classmethod
    def at(cls, axis: Array, chord: Array) -> "Stretch | None":
        """Return it for a (3,) and d − a (3,), or None up to a right angle, where M is I."""
        length = math.sqrt(chord @ chord)
        if not length > RIGHT:
            return None
        direction, along = axis + chord, chord / length
        half = math.atan2(length, float(np.linalg.norm(direction + axis)))
        factor = (RIGHT + SLOPE * (2.0 * half - 0.5 * math.pi)) / length
        slope = SLOPE - factor * math.cos(half)
        return cls(direction, along, _toward(axis, direction), factor, slope, half)

    def apply(self, rates: Array) -> Array:
        """Return M x for x (3,) or (3, n)."""
        return self.factor * rates - self.slope * np.multiply.outer(self.along, self.toward @ rates)

    def transposed(self, pulled: Array) -> Array:
        """Return Mᵀ x for x (3,)."""
        return self.factor * pulled - self.slope * self.toward * (self.along @ pulled)

    def normal(self) -> Array:
        """Return the unit vector at right angles to M x for every x at right angles to d."""
        tilt = self.slope * math.sin(self.half) / (self.factor + self.slope * math.cos(self.half))
        return (self.direction + tilt * self.toward) / math.hypot(1.0, tilt)


def _toward(axis: Array, direction: Array) -> Array:
    """Return the unit vector at right angles to d along which it comes nearer to a."""
    way = axis - direction * (direction @ axis)
    sine = math.sqrt(way @ way)
    if sine > ANTIPODE:
        return way / sine
    first = np.zeros(3)
    first[np.argmin(np.abs(axis))] = 1.0
    first -= direction * (direction @ first)
    first /= math.sqrt(first @ first)
    return SIDEWAYS[0] * first + SIDEWAYS[1] * np.cross(direction, first)


def chord_of(error: Array) -> Array:
    """Return d − a (3,) for e (3,)."""
    length = math.sqrt(error @ error)
    return error if length <= RIGHT else error * (2.0 * math.sin(0.5 * angle_of(length)) / length)


def angle_of(length: float) -> float:
    """Return θ in rad for ρ = ‖e‖."""
    if length <= RIGHT:
        return 2.0 * math.asin(0.5 * length)
    return 0.5 * math.pi + (length - RIGHT) / SLOPE


class PointingTask(HardTask, GainedTask):
    """Point an axis of a frame somewhere; the roll about the axis stays free."""

    B: NonNegative = 1.0
    """Weight of the squared difference of the two unit vectors, a number."""
    frame: FrameName
    """The frame that turns."""
    axis: Direction = (0.0, 0.0, 1.0)
    """The axis that points, in the frame's own coordinates."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the frame's body."""
        return [resolve(model, self.frame).body(model)]

    def pointing(self, model: mujoco.MjModel, start: Array) -> tuple[dict[str, Any], mink.SE3]:
        """Return what the term takes over but for its target, and the frame's pose at the start."""
        handle = resolve(model, self.frame)
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        fields = self.common() | {"weight": weight_array(self.B, 3), "frame": handle, "axis": axis}
        return fields, mink.SE3(handle.pose_at(model, start))


@dataclass(frozen=True, eq=False, kw_only=True)
class PointingTerm(MinkTerm, BendingTerm):
    """Rows e = ρ(θ) (d − a)/‖d − a‖ for an axis a and the direction d that it is to have.

    Both are unit vectors in the frame's own coordinates, θ the angle between them. Up to a right
    angle ρ is ‖d − a‖ = 2 sin(θ/2) and e is mink's d − a. Further on, where the slope of that goes
    to 0, ρ goes on straight: a = −d would pull nowhere, and is left at once.
    """

    decisive: ClassVar[bool] = True
    frame: FrameHandle
    axis: Array

    @abstractmethod
    def turned(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return the rate of d (3,) by the target's velocity (6,)."""

    @abstractmethod
    def carried(self, pose: mink.SE3, target: Array, twist: Array) -> Array:
        """Return the rate of d (3,) by the frame's own velocity (6,), along its axes."""

    def linearize(
        self, task: mink.Task, configuration: mink.Configuration, target: Array
    ) -> tuple[Array, Array]:
        """Return J = M J_d (3, nv) and e (3,), with mink's J_d and d − a."""
        jacobian, chord = super().linearize(task, configuration, target)
        stretch = Stretch.at(self.axis, chord)
        if stretch is None:
            return jacobian, chord
        return stretch.apply(jacobian), stretch.factor * chord

    def feed_forward(
        self, configuration: mink.Configuration, error: Array, target: Array, twist: Array
    ) -> Array:
        """Return M ḋ for the target's velocity."""
        return self._stretched(self.turned(self._pose(configuration), target, twist), error)

    def carry(
        self,
        configuration: mink.Configuration,
        error: Array,
        target: Array,
        twists: Sequence[Array],
    ) -> Array:
        """Return M ḋ for the frame's own velocity."""
        return self._stretched(self.carried(self._pose(configuration), target, twists[0]), error)

    def _pose(self, configuration: mink.Configuration) -> mink.SE3:
        return configuration.get_transform_frame_to_world(self.frame.id, self.frame.kind)

    def _stretched(self, rate: Array, error: Array) -> Array:
        """Return M ḋ (3,) at e (3,)."""
        stretch = Stretch.at(self.axis, chord_of(error))
        return rate if stretch is None else stretch.apply(rate)

    def unstretched(self, pulled: Array, error: Array) -> Array:
        """Return Mᵀ x (3,) at e (3,), what x pulls d with."""
        stretch = Stretch.at(self.axis, chord_of(error))
        return pulled if stretch is None else stretch.transposed(pulled)

    def way(self, model: mujoco.MjModel) -> Way:
        """Return the dofs on the way to the frame."""
        return Way.chain(self.frame.dofs(model))

    @property
    def frames(self) -> tuple[FrameHandle, ...]:
        """The frame."""
        return (self.frame,)

    @property
    def units(self) -> tuple[str, ...]:
        """The angle."""
        return ("rad",)

    def measure(self, error: Array) -> Array:
        """Return θ in rad."""
        return np.array([angle_of(math.sqrt(error @ error))])

    def attainable(self, error: Array, rate: Array) -> Array:
        """Return the part of ẋ that turns the unit vector d: the three rows have rank two."""
        chord = chord_of(error)
        stretch = Stretch.at(self.axis, chord)
        normal = self.axis + chord if stretch is None else stretch.normal()
        return rate - normal * (normal @ rate)
