"""Which of the pairs of a robot and a backend are in the suite, and which in `make test-slow`."""

import pytest

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
