"""The task types: one file each, and one line each in the table."""

from typing import Annotated

from pydantic import Field

from rmrc.tasks.axis_align import AxisAlignTask
from rmrc.tasks.centering import CenteringTask
from rmrc.tasks.clearance import ClearanceTask
from rmrc.tasks.com import ComTask
from rmrc.tasks.coupling import CouplingTask
from rmrc.tasks.frame import FrameTask
from rmrc.tasks.freeze import FreezeTask
from rmrc.tasks.kinetic_energy import KineticEnergyTask
from rmrc.tasks.look_at import LookAtTask
from rmrc.tasks.loop import LoopTask
from rmrc.tasks.manipulability import ManipulabilityTask
from rmrc.tasks.posture import PostureTask
from rmrc.tasks.relative_frame import RelativeFrameTask
from rmrc.tasks.smooth import SmoothTask
from rmrc.tasks.velocity import VelocityTask

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
