"""The `kinetic_energy` task: the motion with the least kinetic energy among equals."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from rmrc.tasks.base import Array, RowlessTerm, TaskModel
from rmrc.text.base import NonNegative


class KineticEnergyTask(TaskModel):
    """Keep the kinetic energy ½ vᵀM(q)v low."""

    type: Literal["kinetic_energy"] = "kinetic_energy"
    B: NonNegative = 1.0
    """Weight of the kinetic energy, a number."""

    def compile(self, model: mujoco.MjModel, start: Array) -> "KineticEnergyTerm":
        """Take the weight; the inertia comes with every step."""
        return KineticEnergyTerm(
            **self.common(),
            weight=np.zeros(0),
            target=start[:0],
            inertia=self.B,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class KineticEnergyTerm(RowlessTerm):
    """A `kinetic_energy` task: it has no rows, and adds B·M(q) to the metric A."""

    inertia: float
