"""rmrc: resolved motion rate control on MuJoCo models, one quadratic program a step."""

from importlib.metadata import version

from rmrc.config.base import Frame, Pose
from rmrc.config.load import load
from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.control.loop import solve
from rmrc.control.paths import (
    ArcPath,
    CirclePath,
    FilePath,
    HoldPath,
    LinePath,
    PosePath,
    WaypointsPath,
)
from rmrc.control.step import Status, Step
from rmrc.errors import ConfigError, ModelError, RmrcError, SolverError
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.problem.tasks import (
    AxisAlignTask,
    CenteringTask,
    ClearanceTask,
    ComTask,
    FrameTask,
    FreezeTask,
    KineticEnergyTask,
    LookAtTask,
    ManipulabilityTask,
    PostureTask,
    RelativeFrameTask,
    SmoothTask,
    VelocityTask,
)
from rmrc.record.compare import Comparison, compare
from rmrc.record.run import Run

__version__ = version("rmrc")

__all__ = [
    "ArcPath",
    "AxisAlignTask",
    "CenteringTask",
    "CirclePath",
    "ClearanceTask",
    "ComTask",
    "Comparison",
    "Config",
    "ConfigError",
    "Controller",
    "FilePath",
    "Frame",
    "FrameTask",
    "FreezeTask",
    "HoldPath",
    "KineticEnergyTask",
    "LinePath",
    "LookAtTask",
    "ManipulabilityTask",
    "ModelError",
    "Pose",
    "PosePath",
    "PostureTask",
    "Problem",
    "RelativeFrameTask",
    "RmrcError",
    "Run",
    "SmoothTask",
    "SolverError",
    "Status",
    "Step",
    "VelocityTask",
    "WaypointsPath",
    "compare",
    "compile",
    "load",
    "solve",
]
