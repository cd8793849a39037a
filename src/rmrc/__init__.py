"""rmrc: resolved motion rate control on MuJoCo models, one quadratic program a step."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rmrc import reference
    from rmrc.config.base import Frame, Pose
    from rmrc.config.load import load
    from rmrc.config.models import Config
    from rmrc.control.batch import BatchController, BatchStep
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
        CouplingTask,
        FrameTask,
        FreezeTask,
        KineticEnergyTask,
        LookAtTask,
        LoopTask,
        ManipulabilityTask,
        PostureTask,
        RelativeFrameTask,
        SmoothTask,
        VelocityTask,
    )
    from rmrc.record.compare import Comparison, compare
    from rmrc.record.run import Run

    __version__: str

# Imported on use: the command line can then answer, and be interrupted, without MuJoCo and mink.
_HOMES = {
    "ArcPath": "rmrc.control.paths",
    "AxisAlignTask": "rmrc.problem.tasks",
    "BatchController": "rmrc.control.batch",
    "BatchStep": "rmrc.control.batch",
    "CenteringTask": "rmrc.problem.tasks",
    "CirclePath": "rmrc.control.paths",
    "ClearanceTask": "rmrc.problem.tasks",
    "ComTask": "rmrc.problem.tasks",
    "Comparison": "rmrc.record.compare",
    "Config": "rmrc.config.models",
    "ConfigError": "rmrc.errors",
    "Controller": "rmrc.control.controller",
    "CouplingTask": "rmrc.problem.tasks",
    "FilePath": "rmrc.control.paths",
    "Frame": "rmrc.config.base",
    "FrameTask": "rmrc.problem.tasks",
    "FreezeTask": "rmrc.problem.tasks",
    "HoldPath": "rmrc.control.paths",
    "KineticEnergyTask": "rmrc.problem.tasks",
    "LinePath": "rmrc.control.paths",
    "LookAtTask": "rmrc.problem.tasks",
    "LoopTask": "rmrc.problem.tasks",
    "ManipulabilityTask": "rmrc.problem.tasks",
    "ModelError": "rmrc.errors",
    "Pose": "rmrc.config.base",
    "PosePath": "rmrc.control.paths",
    "PostureTask": "rmrc.problem.tasks",
    "Problem": "rmrc.problem.problem",
    "RelativeFrameTask": "rmrc.problem.tasks",
    "RmrcError": "rmrc.errors",
    "Run": "rmrc.record.run",
    "SmoothTask": "rmrc.problem.tasks",
    "SolverError": "rmrc.errors",
    "Status": "rmrc.control.step",
    "Step": "rmrc.control.step",
    "VelocityTask": "rmrc.problem.tasks",
    "WaypointsPath": "rmrc.control.paths",
    "compare": "rmrc.record.compare",
    "compile": "rmrc.problem.compile",
    "load": "rmrc.config.load",
    "solve": "rmrc.control.loop",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("rmrc")
    if name == "reference":
        return import_module("rmrc.reference")
    if name not in _HOMES:
        raise AttributeError(f"module 'rmrc' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


__all__ = [
    "ArcPath",
    "AxisAlignTask",
    "BatchController",
    "BatchStep",
    "CenteringTask",
    "CirclePath",
    "ClearanceTask",
    "ComTask",
    "Comparison",
    "Config",
    "ConfigError",
    "Controller",
    "CouplingTask",
    "FilePath",
    "Frame",
    "FrameTask",
    "FreezeTask",
    "HoldPath",
    "KineticEnergyTask",
    "LinePath",
    "LookAtTask",
    "LoopTask",
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
    "reference",
    "solve",
]
