"""rmrc: resolved motion rate control on MuJoCo models, one quadratic program a step."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rmrc import reference
    from rmrc.config.load import load
    from rmrc.config.models import Config
    from rmrc.control.batch import BatchController, BatchStep
    from rmrc.control.controller import Controller
    from rmrc.control.status import Status
    from rmrc.control.step import Step
    from rmrc.errors import ConfigError, ModelError, RmrcError, SolverError
    from rmrc.paths import (
        ArcPath,
        CirclePath,
        FilePath,
        HoldPath,
        LinePath,
        PosePath,
        WaypointsPath,
    )
    from rmrc.problem.compile import compile
    from rmrc.problem.problem import Problem
    from rmrc.record.run import Run
    from rmrc.runs.compare import Comparison, compare
    from rmrc.runs.recorder import Recorder
    from rmrc.runs.solve import solve
    from rmrc.tasks import (
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
    from rmrc.text.base import Frame, Pose

    __version__: str

# Imported on use: the command line can then answer, and be interrupted, without MuJoCo and mink.
_HOMES = {
    "ArcPath": "rmrc.paths",
    "AxisAlignTask": "rmrc.tasks",
    "BatchController": "rmrc.control.batch",
    "BatchStep": "rmrc.control.batch",
    "CenteringTask": "rmrc.tasks",
    "CirclePath": "rmrc.paths",
    "ClearanceTask": "rmrc.tasks",
    "ComTask": "rmrc.tasks",
    "Comparison": "rmrc.runs.compare",
    "Config": "rmrc.config.models",
    "ConfigError": "rmrc.errors",
    "Controller": "rmrc.control.controller",
    "CouplingTask": "rmrc.tasks",
    "FilePath": "rmrc.paths",
    "Frame": "rmrc.text.base",
    "FrameTask": "rmrc.tasks",
    "FreezeTask": "rmrc.tasks",
    "HoldPath": "rmrc.paths",
    "KineticEnergyTask": "rmrc.tasks",
    "LinePath": "rmrc.paths",
    "LookAtTask": "rmrc.tasks",
    "LoopTask": "rmrc.tasks",
    "ManipulabilityTask": "rmrc.tasks",
    "ModelError": "rmrc.errors",
    "Pose": "rmrc.text.base",
    "PosePath": "rmrc.paths",
    "PostureTask": "rmrc.tasks",
    "Problem": "rmrc.problem.problem",
    "Recorder": "rmrc.runs.recorder",
    "RelativeFrameTask": "rmrc.tasks",
    "RmrcError": "rmrc.errors",
    "Run": "rmrc.record.run",
    "SmoothTask": "rmrc.tasks",
    "SolverError": "rmrc.errors",
    "Status": "rmrc.control.status",
    "Step": "rmrc.control.step",
    "VelocityTask": "rmrc.tasks",
    "WaypointsPath": "rmrc.paths",
    "compare": "rmrc.runs.compare",
    "compile": "rmrc.problem.compile",
    "load": "rmrc.config.load",
    "solve": "rmrc.runs.solve",
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
    "Recorder",
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
