"""The includes of native/ go one way: `native/check_includes.py` says where they do not."""

import importlib.util
import sys
from types import ModuleType

import pytest

from models import REPOSITORY


def load() -> ModuleType:
    path = REPOSITORY / "native" / "check_includes.py"
    spec = importlib.util.spec_from_file_location("check_includes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


CHECK = load()


def test_the_includes_of_this_checkout_go_one_way() -> None:
    graph = CHECK.included(REPOSITORY / "native")
    assert len(graph) > 90
    assert list(CHECK.mistakes(graph)) == []


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        ({"base/a.hpp": {"solver/b.hpp"}, "solver/b.hpp": set()}, "solver comes after base"),
        (
            {"base/a.hpp": {"base/b.hpp"}, "base/b.hpp": {"base/a.hpp"}},
            "a circle of includes: base/",
        ),
        ({"base/a.hpp": {"b.hpp"}}, "is no file below native/"),
        ({"engine/a.cpp": {"tests/b.hpp"}, "tests/b.hpp": set()}, "only tests may"),
        ({"a.cpp": set()}, "is in none of the folders"),
        ({"old/a.cpp": set()}, "is in none of the folders"),
    ],
)
def test_what_breaks_the_order_is_named(graph: dict[str, set[str]], said: str) -> None:
    (mistake,) = CHECK.mistakes(graph)
    assert said in mistake


def test_tests_may_include_all() -> None:
    graph = {"tests/a.cpp": {"control/b.hpp", "tests/c.hpp"}, "control/b.hpp": set()}
    assert list(CHECK.mistakes({**graph, "tests/c.hpp": set()})) == []
