"""Models with closed chains and couplings, and their equalities."""

from pathlib import Path
from typing import Any

import numpy as np

import rmrc
from models import config
from rmrc.problem.evaluation import Evaluation
from rmrc.qp.assemble import Assembly
from rmrc.qp.equalities import Equalities

# The same numbers by another route: rounding alone.
EXACT = 1e-12


def panda(*tasks: dict[str, Any], **others: Any) -> rmrc.Config:
    others = {"damping": {"curvature": False}, **others}
    return config("scenes/panda.xml", list(tasks), start="home", **others)


def compiled(given: rmrc.Config, repository: Path) -> rmrc.Problem:
    return rmrc.compile(given.rooted(repository))


def equalities_of(problem: rmrc.Problem, q: np.ndarray | None = None) -> Equalities:
    """Return E and f at q, by default the start."""
    evaluation = Evaluation(problem)
    assembly = Assembly(problem, evaluation)
    at = problem.start if q is None else q
    evaluation.update(at)
    evaluation.evaluate()
    assembly.assemble(at, problem.dt)
    found = assembly.equalities()
    assert found is not None
    return found
