"""Constants that both languages name, as `// rmrc.qp.cascade.WHOLE` behind the C++ one, agree."""

import math
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import REPOSITORY
from rmrc.control.status import Status

SOURCES = sorted(
    path for path in (REPOSITORY / "native").glob("*/*.[ch]pp") if path.parent.name != "tests"
)
CONSTANT = re.compile(
    r"^(?:static )?constexpr (?:double|int|unsigned) (\w+)(?:\[\d*\])? = ([^;]+);(.*)$"
)
NAMED = re.compile(r"\brmrc((?:\.\w+)+)\.([A-Z][A-Z_]+)\b")
LISTED = re.compile(r"\brmrc((?:\.[a-z_]+)+): ([A-Z][A-Z_, and]+)")
MODULE = re.compile(r"^// rmrc((?:\.[a-z_]+)+)$")
FOUND = 70
"""Pairs that there are at least: less, and the patterns miss some."""


def pairs(text: str) -> list[tuple[str, str, str]]:
    """Return the values of a C++ file that name a constant of Python's: value, module, name.

    The name stands behind the value, after its module; or behind it alone, below a comment that is
    a module; or in a comment above that lists names in the order of the constants that follow.
    """
    found: list[tuple[str, str, str]] = []
    listed: list[tuple[str, str]] = []
    module = ""
    for line in text.splitlines():
        constant = CONSTANT.match(line.strip())
        if constant is None:
            if alone := MODULE.match(line.strip()):
                module = alone[1]
            elif line.startswith("//"):
                names = [(part[1], n) for part in LISTED.finditer(line) for n in named_in(part[2])]
                listed = names + [(n[1], n[2]) for n in NAMED.finditer(line)]
            elif not line.strip():
                listed, module = [], ""
            continue
        _, value, behind = constant.groups()
        if name := NAMED.search(behind):
            found.append((value, name[1], name[2]))
        elif module and (alone := re.search(r"// ([A-Z_]+)$", behind)):
            found.append((value, module, alone[1]))
        elif listed:
            found.append((value, *listed.pop(0)))
    assert not listed, f"no constants for {listed}"
    return found


def named_in(text: str) -> list[str]:
    return re.findall(r"[A-Z][A-Z_]+", text)


def number(value: str) -> Any:
    """Return the value of a C++ expression."""
    value = value.replace("std::numeric_limits<double>::epsilon()", repr(sys.float_info.epsilon))
    value = value.replace("std::numbers::sqrt2", repr(math.sqrt(2.0)))
    value = re.sub(r"\b(\d+)u\b", r"\1", value).replace("{", "[").replace("}", "]")
    return eval(value, {"__builtins__": {}})


def home(module: str) -> Any:
    """Return the module or the class of a dotted name below rmrc."""
    if module.rpartition(".")[2][0].isupper():
        above, _, name = module.rpartition(".")
        return getattr(import_module(f"rmrc{above}"), name)
    return import_module(f"rmrc{module}")


ALL = [(path.name, *pair) for path in SOURCES for pair in pairs(path.read_text())]


@pytest.mark.parametrize(("file", "value", "module", "name"), ALL, ids=lambda part: str(part)[:40])
def test_a_constant_is_the_same_in_both(file: str, value: str, module: str, name: str) -> None:
    expected = getattr(home(module), name)
    expected = 1 << expected if isinstance(expected, Status) else expected
    assert np.array_equal(number(value), expected), f"{file}: {value} is not {module}.{name}"


def test_there_are_as_many_as_there_were() -> None:
    assert len(ALL) >= FOUND, len(ALL)
    assert len({file for file, *_ in ALL}) > 15


@pytest.mark.parametrize(
    "text",
    [
        "constexpr double whole = 2.0;  // rmrc.qp.cascade.WHOLE",
        "// rmrc.qp.cascade: WHOLE and RANK.\nconstexpr double a = 1.0;\nconstexpr double b = 2.0;",
        "// rmrc.qp.cascade\nconstexpr double still = 2.0;  // STILL",
    ],
)
def test_each_way_of_naming_is_read(text: str) -> None:
    assert pairs(text)


def test_a_value_that_differs_is_found(tmp_path: Path) -> None:
    ((value, module, name),) = pairs("constexpr double whole = 2.0;  // rmrc.qp.cascade.WHOLE")
    with pytest.raises(AssertionError):
        test_a_constant_is_the_same_in_both("a.cpp", value, module, name)
