"""Which pairs of a robot and a backend the suite has, and the problems that inputs are tried on."""

from pathlib import Path

import pytest
from input_twins import compiled
from matrix import with_backend

import rmrc

ROBOTS = ("panda", "dual_arm", "biped")
"""Those that every backend has: one arm, two, and a floating base. The default backend has all
robots, and daqp by its name is in `make test-slow`: what a robot changes and what a backend changes
seldom depend on each other."""


@pytest.hookimpl(tryfirst=True)  # before the slow ones are deselected
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        given = (
            item.callspec.params
            if isinstance(item, pytest.Function) and hasattr(item, "callspec")
            else {}
        )
        robot, backend = given.get("robot", "panda"), given.get("backend", "auto")
        if backend == "daqp" or (backend != "auto" and robot not in ROBOTS):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where scenes are written to."""
    return tmp_path_factory.mktemp("scenes")


@pytest.fixture
def free(robot: str, backend: str, folder: Path) -> rmrc.Problem:
    """The problem without acceleration limits."""
    return with_backend(compiled(robot, folder, False), backend)


@pytest.fixture
def slow(robot: str, backend: str, folder: Path) -> rmrc.Problem:
    """The problem with acceleration limits."""
    return with_backend(compiled(robot, folder, True), backend)
