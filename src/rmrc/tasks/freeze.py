"""The `freeze` task: some joints are held still."""

from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rmrc.model.configuration import dof_of_joint
from rmrc.model.objects import bodies_of_joints
from rmrc.tasks.base import Array, RowlessTerm, TaskModel
from rmrc.text.base import JointName


class FreezeTask(TaskModel):
    """Hold joints still: v_i = 0, exactly. It has no weight, for it is no cost."""

    type: Literal["freeze"] = "freeze"
    joints: Annotated[tuple[JointName, ...], Field(min_length=1)]
    """The joints that are held."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints."""
        return bodies_of_joints(model, self.joints)

    def compile(self, model: mujoco.MjModel, start: Array) -> "FreezeTerm":
        """Resolve the joints."""
        dofs = np.concatenate([np.atleast_1d(dof_of_joint(model, j)) for j in self.joints])
        return FreezeTerm(
            **self.common(),
            weight=np.zeros(0),
            target=start[:0],
            dofs=dofs,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class FreezeTerm(RowlessTerm):
    """A `freeze` task: a velocity limit of zero on its dofs, an equality inside the one box."""

    dofs: NDArray[np.intp]
