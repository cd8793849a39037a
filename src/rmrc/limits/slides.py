"""How much more than their levers say turning slides can move what they carry."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.configuration import turning_dofs
from rmrc.model.extents import counted_travel, dofs_of_bodies

Array = NDArray[np.float64]


class Slides:
    """The slides that other joints turn: how far they are beyond the travel that levers count.

    A rotation by θ moves what a slide behind it carries by up to |θ| e more than levers say, if the
    slide is further from its zero than counted by e, as if the slide itself had moved by |θ| e. So
    the levers hold wherever the joints are, for steps in which the slides' shares are stretched.
    """

    def __init__(self, model: mujoco.MjModel, obstacle_twist: Array):
        dofs = np.flatnonzero(model.dof_jntid >= 0)
        slides = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
        moves, turning = dofs_of_bodies(model), turning_dofs(model)
        before = np.array(
            [
                moves[model.jnt_bodyid[joint]] & turning & (dofs < model.jnt_dofadr[joint])
                for joint in slides
            ]
        ).reshape(slides.size, model.nv)
        mocap = model.body_mocapid[model.body_rootid[model.jnt_bodyid[slides]]]
        turned = before.any(axis=1) | (mocap >= 0)
        slides, self._mocap = slides[turned], mocap[turned]
        self._before = before[turned].astype(float)
        self._twist = obstacle_twist
        self._coordinate = model.jnt_qposadr[slides]
        self._dof = model.jnt_dofadr[slides]
        self._zero = model.qpos0[self._coordinate]
        self._counted = np.array([counted_travel(model, joint) for joint in slides.tolist()])
        self._beyond = np.zeros(slides.size)

    def begin(self, q: Array, travel: Array) -> None:
        """Note how far the slides are beyond at q (nq,), or may come by a travel (nv,)."""
        out = np.abs(q[self._coordinate] - self._zero) + travel[self._dof]
        self._beyond = np.maximum(out - self._counted, 0.0)

    def stretch(self, step: Array, dt: float) -> None:
        """Add to a step |Δq| (nv,) of dt, or to rates of it, in place, what levers leave out."""
        if not self._beyond.any():
            return
        turn = self._before @ step
        on_mocap = self._mocap >= 0
        turn[on_mocap] += np.abs(self._twist[self._mocap[on_mocap], 3:]).sum(axis=1) * dt
        step[self._dof] += turn * self._beyond

    def described(self) -> list[tuple[Any, ...]]:
        """Return what the extension knows of each slide: see `native/limits/slides.hpp`."""
        before = [row.nonzero()[0].tolist() for row in self._before]
        columns = (self._coordinate, self._dof, self._zero, self._counted, self._mocap)
        return list(zip(*(column.tolist() for column in columns), before, strict=True))
