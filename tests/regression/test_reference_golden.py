"""The closed forms agree with the golden numbers of planar arms with unit links."""

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rmrc import reference
from rmrc.reference.damped import FACTORIZATIONS, FORMS

# Relative to the largest expected entry, or absolute below 1: what the file promises.
GOLDEN = 1e-9

Case = dict[str, Any]


def dls(case: Case) -> np.ndarray:
    """Return the result of every form and factorization, one a row."""
    J, xdot, damping = case["J"], case["xdot"], case["damping"]
    ways = product(FORMS, FACTORIZATIONS)
    return np.array([reference.dls(J, xdot, damping, form, kind) for form, kind in ways])


def pinv(case: Case) -> np.ndarray:
    return reference.pinv(case["J"], case["xdot"])


def null_space(case: Case) -> np.ndarray:
    return pinv(case) + reference.nullspace_projector(case["J"]) @ case["v0"]


def strict(case: Case) -> np.ndarray:
    return reference.prioritized([(case["level_1"], [1.0]), (case["level_2"], [1.0])])


def saturated(case: Case) -> np.ndarray:
    limit = np.array(case["v_max"])
    return reference.saturated(case["J"], case["xdot"], -limit, limit)


def share(case: Case) -> np.ndarray:
    xdot = np.array(case["xdot"])
    return np.array([xdot @ case["J"] @ saturated(case) / (xdot @ xdot)])


def attained(case: Case) -> np.ndarray:
    limit = np.array(case["v_max"])
    return case["J"] @ reference.bounded_dls(case["J"], case["xdot"], -limit, limit, 1e-6)


METHODS: dict[str, Callable[[Case], np.ndarray]] = {
    "2r inverse": lambda case: np.array(
        [
            reference.inverse(case["J"], case["xdot"]),
            reference.planar_2r.velocity(case["q"], case["xdot"]),
        ]
    ),
    "2r transpose, optimal step": lambda case: np.array(
        [
            reference.transpose(case["J"], case["xdot"]),
            reference.transpose(case["J"], case["xdot"], gain=case["alpha"]),
        ]
    ),
    "2r dls lambda=1.0": dls,
    "2r dls lambda=0.1": dls,
    "2r singular, reachable direction, pinv": pinv,
    "2r singular, lost direction, pinv": pinv,
    "2r singular, dls lambda=0.1": dls,
    "2r near singular q2=0.01, pinv": pinv,
    "2r near singular q2=0.01, dls lambda=0.1": dls,
    "2r near singular q2=0.0001, pinv": pinv,
    "2r near singular q2=0.0001, dls lambda=0.1": dls,
    "2r near singular q2=1e-06, pinv": pinv,
    "2r near singular q2=1e-06, dls lambda=0.1": dls,
    "3r right pseudo-inverse": lambda case: reference.pinv(case["J"], case["xdot"], form="right"),
    "3r weighted, A=diag(1,1,4)": lambda case: reference.weighted(
        case["J"], case["xdot"], case["A"]
    ),
    "3r weighted damped, B=diag(4,1), A=0.01 I": lambda case: reference.weighted_dls(
        case["J"], case["xdot"], case["A"], case["B"], damping=0.0
    ),
    "3r null-space projection of v0": null_space,
    "3r strict priority: row x first, then sum of joint rates = 1": strict,
    "4r pinv": pinv,
    "4r least-norm within |v| <= V": saturated,
    "4r bounded least squares, |v| <= 1, task velocity attained": attained,
    "4r direction kept, |v| <= 1, largest attainable share of xdot": share,
}


@pytest.fixture(scope="module")
def golden(repository: Path) -> dict[str, Case]:
    path = repository.parent / "shared" / "golden" / "closed_form.json"
    if not path.is_file():
        pytest.skip("needs the golden cases, shared/golden/closed_form.json beside the repository")
    cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
    return {case["name"]: case for case in cases}


def test_every_golden_case_has_its_method(golden: dict[str, Case]) -> None:
    assert golden.keys() == METHODS.keys()


@pytest.mark.parametrize("name", METHODS)
def test_golden(name: str, golden: dict[str, Case]) -> None:
    expected = np.array(golden[name]["expect"])
    off = abs(METHODS[name](golden[name]) - expected).max()
    assert off <= GOLDEN * max(1.0, abs(expected).max())


def test_golden_jacobians_are_those_of_the_planar_arm(golden: dict[str, Case]) -> None:
    two_links = [case for name, case in golden.items() if name.startswith("2r")]
    for case in two_links:
        assert abs(reference.planar_2r.jacobian(case["q"]) - case["J"]).max() <= GOLDEN
