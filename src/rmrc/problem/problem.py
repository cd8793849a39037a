"""`Problem`: what a controller solves, with every name resolved."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.config.models import Config
from rmrc.errors import ModelError, unknown_name
from rmrc.limits.barrier import BarrierLimit
from rmrc.limits.box import Box
from rmrc.limits.speed import FrameSpeed
from rmrc.model.extents import FINEST
from rmrc.model.objects import Objects
from rmrc.model.scene import Scene
from rmrc.tasks.base import Term
from rmrc.tasks.frame import FrameTerm

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A model, the terms of the cost, the limits, and what the step is taken with."""

    config: Config
    begun: tuple[Scene, Array, list[str]]
    """What was compiled first: the scene, the start, and what is to be said of it."""
    model: mujoco.MjModel
    """Its mocap bodies are where the start has them, so that every fresh mjData has them there."""
    start: Array
    """Start configuration (nq,)."""
    dt: float
    """Length of a step, s."""
    dofs: NDArray[np.intp]
    """The dofs that may move (n,), the columns of the program."""
    objects: Objects
    """What of the model is not the robot: it is where q says it is, and does not move."""
    terms: tuple[Term, ...]
    metric: Array
    """The constant part of A (nv, nv)."""
    inertia: float
    """The share of M(q) in A."""
    damping: float
    """λ₀, the floor of λ."""
    curvature: bool
    """Whether X is in the program, and what drives the errors brakes in time."""
    soft_ratio: float
    """What multiplies a level's B, once for each level below the highest; 1 if they are strict."""
    strict: bool
    """Whether a level moves only in the null space of those above."""
    box: Box
    """The joint limits (n,)."""
    lag: Array
    """Time constants of the drives (nv,), s; 0 where commands are carried out at once."""
    notices: tuple[str, ...]
    """What a user should know: defaults at work, and what has no limit."""
    barriers: tuple[BarrierLimit, ...] = ()
    """The distances that stay above 0: collision, workspace, ranges of ball joints."""
    resolution: float = FINEST
    """A distance this little below its limit, m or rad, is on it: none is kept more finely."""
    speeds: tuple[FrameSpeed, ...] = ()
    """The largest speeds of frames."""
    deadline: float = math.inf
    """Time budget of a step, s."""
    target_timeout: float = math.inf
    """Age of a target that has been set beyond which it is stale, s."""
    measurement_timeout: float = math.inf
    """Age of the measured configuration beyond which it is stale, s."""
    mink_tasks: tuple[BaseTask, ...] = ()
    mink_limits: tuple[mink.Limit, ...] = ()

    def __post_init__(self):
        # Engines have taken what they need of these: a change of them would be lost without a word.
        for array in (self.start, self.dofs, self.metric, *vars(self.box).values()):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()  # pickled arrays come back writable

    def __repr__(self) -> str:
        tasks = ", ".join(term.name for term in self.terms)
        return f"Problem({self.dofs.size} dofs, tasks: {tasks or 'none'}, dt={self.dt:g})"

    @cached_property
    def term(self) -> Mapping[str, Term]:
        """The terms by name."""
        return {term.name: term for term in self.terms}

    @property
    def cascaded(self) -> bool:
        """Whether levels are solved one after another: strict ones, or one with a direction."""
        return self.strict or any(term.preserve for term in self.terms)

    def named(self, name: str) -> Term:
        """Return a term by name.

        Raises:
            ModelError: If there is no such task; the message lists those there are.
        """
        try:
            return self.term[name]
        except KeyError:
            raise ModelError(unknown_name("task", name, self.term)) from None

    def forward(self, q: Array) -> dict[str, Array]:
        """Return the pose (4, 4) in the world of each `frame` task's frame at q (nq,)."""
        q = np.asarray(q, dtype=float)
        if q.shape != (self.model.nq,):
            raise ModelError(f"q has shape {q.shape}, and this model's is ({self.model.nq},)")
        return {
            term.name: mink.SE3(term.frame.pose_at(self.model, q)).as_matrix()
            for term in self.terms
            if isinstance(term, FrameTerm)
        }
