"""The task types: one file each, and one line each in the table."""

from typing import Annotated

from pydantic import Field

from rmrc.problem.tasks.axis_align import AxisAlignTask
from rmrc.problem.tasks.centering import CenteringTask
from rmrc.problem.tasks.clearance import ClearanceTask
from rmrc.problem.tasks.com import ComTask
from rmrc.problem.tasks.coupling import CouplingTask
from rmrc.problem.tasks.frame import FrameTask
from rmrc.problem.tasks.freeze import FreezeTask
from rmrc.problem.tasks.kinetic_energy import KineticEnergyTask
from rmrc.problem.tasks.look_at import LookAtTask
from rmrc.problem.tasks.loop import LoopTask
from rmrc.problem.tasks.manipulability import ManipulabilityTask
from rmrc.problem.tasks.posture import PostureTask
from rmrc.problem.tasks.relative_frame import RelativeFrameTask
from rmrc.problem.tasks.smooth import SmoothTask
from rmrc.problem.tasks.velocity import VelocityTask

__all__ = [
    "AxisAlignTask",
    "CenteringTask",
    "ClearanceTask",
    "ComTask",
    "CouplingTask",
    "FrameTask",
    "FreezeTask",
    "KineticEnergyTask",
    "LookAtTask",
    "LoopTask",
    "ManipulabilityTask",
    "PostureTask",
    "RelativeFrameTask",
    "SmoothTask",
    "Task",
    "VelocityTask",
]

Task = Annotated[
    FrameTask
    | RelativeFrameTask
    | ComTask
    | PostureTask
    | VelocityTask
    | SmoothTask
    | KineticEnergyTask
    | LookAtTask
    | AxisAlignTask
    | FreezeTask
    | LoopTask
    | CouplingTask
    | CenteringTask
    | ManipulabilityTask
    | ClearanceTask,
    Field(discriminator="type"),
]
"""Any task of a configuration, told apart by `type`."""
