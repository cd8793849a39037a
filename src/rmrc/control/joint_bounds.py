"""Which limit put a joint's bound where it is."""

import math
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.control.context import Moment
from rmrc.limits.box import BoxLimit
from rmrc.limits.joints import joint_name
from rmrc.model.configuration import joint_type

Array = NDArray[np.float64]

SAME = 1e-9
"""Two bounds that differ by less than this, rad/s or m/s, are the same."""


class JointBounds:
    """Names the bounds of a step, at whose state the engine has to be."""

    def __init__(self, moment: Moment):
        self._problem, self._moment = moment.engine.problem, moment
        self._qp = moment.engine.assembly.qp

    def name(self, k: int) -> str:
        """Return the name of the joint of a column of the program."""
        model = self._problem.model
        return joint_name(model, int(model.dof_jntid[self._problem.dofs[k]]))

    def bound(self, k: int, side: str) -> float:
        """Return where the lower or upper bound of a column stands, rad/s or m/s."""
        return float((self._qp.ub if side == "upper" else self._qp.lb)[k])

    def kind(self, k: int, side: str) -> str:
        """Return the limit that a bound is of, as the configuration names it."""
        problem, bound = self._problem, self.bound(k, side)
        joint = int(problem.model.dof_jntid[problem.dofs[k]])
        further = (kind for kind, box in self._without.items() if _is_further(box, k, side, bound))
        kind = next(further, "jerk")
        if kind == "velocity" and problem.box.velocity[k] == 0.0:
            return "freeze"
        if kind == "velocity" and joint_type(problem.model, joint) == mujoco.mjtJoint.mjJNT_FREE:
            return "base"
        return kind

    @cached_property
    def _without(self) -> dict[str, BoxLimit]:
        """The box without position limits; without those of velocity, too; and so on.

        The first in which a bound stands further out tells which limit put it there.
        """
        problem, moment = self._problem, self._moment
        box, dofs, boxes = problem.box, problem.dofs, {}
        infinite = np.full(dofs.size, math.inf)
        for kind, gone in (
            ("position", {"lower": -infinite, "upper": infinite}),
            ("velocity", {"velocity": infinite, "step": math.inf}),
            ("acceleration", {"acceleration": infinite}),
        ):
            box = replace(box, **gone)
            boxes[kind] = BoxLimit(box)
            before = moment.v_previous[dofs], moment.a_previous[dofs]
            boxes[kind].update(moment.q, *before, moment.dt)
        return boxes


def _is_further(box: BoxLimit, k: int, side: str, bound: float) -> bool:
    """Return whether an end of a joint's interval stands further out than a bound."""
    return box.upper[k] > bound + SAME if side == "upper" else box.lower[k] < bound - SAME
