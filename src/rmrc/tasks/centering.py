"""The `centering` task: the joints stay near the middle of their ranges, away from the limits."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import mujoco
import numpy as np
from pydantic import Field

from rmrc.model.configuration import QPOS_WIDTH, joint_type, turning_dofs
from rmrc.model.frames import find
from rmrc.model.objects import bodies_of_joints
from rmrc.tasks.base import Array, FieldError, GainedTask, TargetKind
from rmrc.tasks.posture import PostureTerm
from rmrc.text.base import JointName, NonNegative


class CenteringTask(GainedTask):
    """Bring the joints to the middle of their ranges; those without a range are left alone.

    For the middle m and the half h of each range it descends H = ½ Σ ((q − m)/h)², which is 0 in
    the middle and ½ for each joint at a limit. With e = m − q and the weight B/h² the cost is
    ½ B Σ ((v − K e)/h)²: its gradient at v = 0 is B K ∇H, and its optimum where nothing else is
    asked for is Newton's step on H, with which every joint goes to its middle as exp(−K t).

    Source: Liégeois 1977, Automatic supervisory control of the configuration and behavior of
    multibody mechanisms; his criterion is H up to a factor.
    """

    type: Literal["centering"] = "centering"
    B: NonNegative = 1.0
    """Weight of the squared shares of the half ranges, a number."""
    joints: Annotated[tuple[JointName, ...], Field(min_length=1)] | None = None
    """The joints that are meant; by default all hinges and slides that have a range."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the bodies of the joints that are named."""
        return bodies_of_joints(model, self.joints or ())

    def compile(self, model: mujoco.MjModel, start: Array) -> "CenteringTerm":
        """Find the middles of the ranges.

        Raises:
            FieldError: If a joint that is named, or every joint of the model, has no range.
        """
        middle, weight = start.copy(), np.zeros(model.nv)
        for joint in self._ranged(model):
            low, high = model.jnt_range[joint]
            middle[model.jnt_qposadr[joint]] = 0.5 * (low + high)
            weight[model.jnt_dofadr[joint]] = self.B / (0.5 * (high - low)) ** 2
        return CenteringTerm(
            **self.common(),
            weight=weight,
            target=middle,
            turning=turning_dofs(model),
        )

    def _ranged(self, model: mujoco.MjModel) -> list[int]:
        """Return the joints that are meant."""
        ranged = [
            joint
            for joint in range(model.njnt)
            if model.jnt_limited[joint] and QPOS_WIDTH[joint_type(model, joint)] == 1
        ]
        if not ranged:
            raise FieldError("joints", "no hinge or slide of this model has a range")
        named = {name: find(model, "joint", name) for name in self.joints or ()}
        for name, joint in named.items():
            if joint not in ranged:
                raise FieldError("joints", f"joint '{name}' is no hinge or slide with a range")
        return list(named.values()) or ranged


@dataclass(frozen=True, eq=False, kw_only=True)
class CenteringTerm(PostureTerm):
    """A `centering` task: a posture whose target is the middle of the ranges, and stays there."""

    target_kind: ClassVar[TargetKind] = "none"
