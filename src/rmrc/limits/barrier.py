"""Barriers: distances that must not fall below 0, whatever they are distances of."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(eq=False)
class Near:
    """The entries of a barrier that may bind in a step, in the order of their ids."""

    ids: NDArray[np.intp]
    """Which entries they are (k,)."""
    distance: Array
    """h above the limit (k,), m or rad; below 0 the limit is passed."""
    slope: Array
    """∂h/∂q (k, nv), per rad/s or m/s."""
    drift: Array
    """∂h/∂t (k,) of what moves by itself, m/s or rad/s."""


class BarrierLimit(Protocol):
    """A limit of a problem that is kept as a barrier."""

    def build(self, model: mujoco.MjModel, obstacle_twist: Array) -> "Barrier":
        """Return the barrier, with buffers of its own.

        Args:
            model: The model.
            obstacle_twist: Velocities of the mocap bodies (nmocap, 6), linear and angular in the
                world, m/s and rad/s; whoever moves them writes into it.
        """
        ...


class Barrier(ABC):
    """A source of distances h(q) that stay at 0 or above.

    A step asks for ∂h/∂q v + ∂h/∂t ≥ −gain h/dt of those that are near, and for a way back at
    no more than `push` where h < 0.
    """

    kind: ClassVar[str]
    """The limit it belongs to, as the configuration names it."""
    unit: ClassVar[str]
    """m or rad."""
    size: int
    """How many entries it has."""
    gain: float
    """Share of h that a step may use, in (0, 1]."""
    most_kept: int = 0
    """How many functions `kept` can give."""
    push: float
    """Largest speed of the way back, in units a second."""

    @abstractmethod
    def near(self, data: mujoco.MjData, travel: Array, dt: float) -> Near:
        """Return what may bind in a step, at the kinematics of `data`.

        Args:
            data: With `mj_kinematics` and `mj_comPos` done.
            travel: The most that each dof can move in the step (nv,), rad or m.
            dt: Length of the step, s.
        """

    def kept(self, data: mujoco.MjData) -> Near | None:
        """Return further functions that bound h from above, after `near` at the same kinematics.

        Of an entry that is near they are rows as it is, and no more than it asks for.
        """
        return None

    @property
    def memory(self) -> tuple[NDArray[Any], ...]:
        """What a step leaves to the next."""
        return ()

    def forget(self) -> None:
        """Forget what such functions are of."""
        return

    @abstractmethod
    def distances(self, data: mujoco.MjData, ids: NDArray[np.intp]) -> Array:
        """Return h of some entries (k,) at other kinematics."""

    @abstractmethod
    def reach(self, ids: NDArray[np.intp], step: Array, dt: float) -> Array:
        """Return the most by which h of some entries (k,) can fall in a step |Δq| (nv,) of dt.

        The step, as the travel of `near`, has been stretched by `Slides`.
        """

    def thickness(self, ids: NDArray[np.intp]) -> Array:
        """Return how far some entries (k,) may move between two looks, not to pass unnoticed."""
        return np.full(ids.size, np.inf)

    @abstractmethod
    def name(self, identity: int) -> str:
        """Return what a message calls an entry."""

    @abstractmethod
    def least(self, data: mujoco.MjData) -> tuple[float, int]:
        """Return the least h of all entries and the id it is of, for the record.

        It is exact where it is below what limits the motion; above that, a lower bound.
        """
