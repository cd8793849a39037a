"""Fixtures that every test may use: the repository's folders and the Menagerie's robots."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
# The real robots are beside the checkout where there are any; MENAGERIE_ROOT says otherwise.
MENAGERIE = Path(os.environ.get("MENAGERIE_ROOT") or REPOSITORY.parent / "shared" / "menagerie")
ABSENT = "needs the Menagerie's robots: set MENAGERIE_ROOT to a checkout"


def skip_instead_of_downloading() -> None:
    """Have whatever asks for a robot that is not on the disk skip its test, by name."""
    with suppress(ImportError):
        import mujoco_menagerie

        xml = mujoco_menagerie.Robot.xml

        def present(robot: Any, *arguments: Any) -> Path:
            if "MENAGERIE_ROOT" not in os.environ:
                pytest.skip(ABSENT)
            return xml(robot, *arguments)

        mujoco_menagerie.Robot.xml = present  # pyright: ignore[reportAttributeAccessIssue]


if MENAGERIE.is_dir():
    os.environ["MENAGERIE_ROOT"] = str(MENAGERIE)
else:
    os.environ.pop("MENAGERIE_ROOT", None)  # a folder that is not there is no checkout
    skip_instead_of_downloading()


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def menagerie() -> Path:
    """The folder of the Menagerie's robots; the test is skipped, by name, where it is absent."""
    if not MENAGERIE.is_dir():
        pytest.skip(ABSENT)
    return MENAGERIE


@pytest.fixture(params=["python", "native"])
def engine(request: pytest.FixtureRequest) -> Any:
    """The name of each engine; the native one's tests are skipped where it is not built."""
    if request.param == "native":
        pytest.importorskip(
            "rmrc._native", reason="the native extension is not built", exc_type=ImportError
        )
    return request.param
