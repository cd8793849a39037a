"""The paths of targets, one file for each type."""

from typing import Annotated, get_args

from pydantic import Field

from rmrc.paths.arc import ArcPath
from rmrc.paths.base import PathModel, Trajectory
from rmrc.paths.circle import CirclePath
from rmrc.paths.file import FilePath
from rmrc.paths.hold import HoldPath
from rmrc.paths.line import LinePath
from rmrc.paths.pose import PosePath
from rmrc.paths.waypoints import WaypointsPath

# The table of paths: the key `path` chooses.
PathConfig = Annotated[
    HoldPath | PosePath | LinePath | ArcPath | CirclePath | WaypointsPath | FilePath,
    Field(discriminator="path"),
]
PATHS: tuple[type[PathModel], ...] = get_args(get_args(PathConfig)[0])

__all__ = [
    "PATHS",
    "ArcPath",
    "CirclePath",
    "FilePath",
    "HoldPath",
    "LinePath",
    "PathConfig",
    "PathModel",
    "PosePath",
    "Trajectory",
    "WaypointsPath",
]
