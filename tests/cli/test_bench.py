"""`rmrc bench`: the step on this machine, and whether the native engine is there."""

import json
import sys
from typing import Any

import pytest
from typer.testing import CliRunner

from models import REPOSITORY
from rmrc.cli import app
from rmrc.control.engines import missing

LINE = REPOSITORY / "configs" / "planar_line.yaml"


def bench(*arguments: object) -> str:
    done = CliRunner().invoke(app, ["bench", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def numbers(*arguments: object) -> dict[str, Any]:
    return json.loads(bench(*arguments, "--json"))


def test_without_a_configuration_every_engine_steps_an_arm() -> None:
    found = numbers()
    assert found["dofs"] == 7
    engines = {"python"} if missing() else {"python", "native"}
    assert set(found["engines"]) == engines
    for times in found["engines"].values():
        assert 0 < times["median_us"] <= times["p99_us"]


def test_a_configuration_of_ones_own_is_timed() -> None:
    found = numbers(LINE)
    assert bool(found["notices"]) is not found["native"]
    assert found["dofs"] == 3
    assert found["steps"] > 0
    assert "µs a step" in bench(LINE)


def test_without_the_extension_it_says_so_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rmrc.native.engine", None)
    shown = bench(LINE)
    assert shown.count("the native engine is not there") == 1
    assert "native engine: installed" not in shown
    assert "python" in shown
