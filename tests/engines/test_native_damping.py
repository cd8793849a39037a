"""The native engine's λ beside that of numpy's singular values: on the way to singularities,
through them, and from one side to the other at once.
"""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config, random_configuration

pytest.importorskip(
    "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
)

Array = NDArray[np.float64]

SAME = 1e-12
"""Of λ_a², relative to its largest: rounding of σ, 1e-15 of σ₁, divided by the threshold."""
LARGEST = 0.3
OFF = {"position": "off", "velocity": "off"}
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "B": 0.01}


def frame(site: str, **others: Any) -> dict[str, Any]:
    return {"name": site, "type": "frame", "frame": {"site": site}, **others}


POINT = {"position": 1.0, "orientation": 0.0}
CASES: dict[str, tuple[str, list[dict[str, Any]], float]] = {
    "more dofs than rows": ("panda", [frame("hand"), POSTURE], 0.05),
    "more rows than dofs": ("panda", [frame("hand"), {"name": "com", "type": "com"}], 0.01),
    "weighed rows": ("ur5e", [frame("tool", B=POINT)], 0.4),
    "rows that nothing serves": ("planar_3r", [frame("hand")], 0.3),
    "frames of a floating base": (
        "biped",
        [frame("left_foot"), frame("right_foot"), frame("left_hand"), POSTURE],
        0.1,
    ),
}


def problem_of(case: str, adapt: str) -> rmrc.Problem:
    scene, tasks, threshold = CASES[case]
    damping = {"lambda": 0.01, "adapt": adapt, "largest": LARGEST, "threshold": threshold}
    path = str(REPOSITORY / "scenes" / f"{scene}.xml")
    return rmrc.compile(config(path, tasks, damping=damping, limits=OFF))


def configurations(model: mujoco.MjModel, start: Array) -> Iterator[Array]:
    """Yield ways from random configurations to that of all joints at zero, and jumps beyond it."""
    rng = np.random.default_rng(0)
    apart = np.empty(model.nv)
    for _ in range(6):
        first = random_configuration(model, start, rng, 1.5)
        mujoco.mj_differentiatePos(model, apart, 1.0, first, model.qpos0)
        for share in (*np.linspace(0.0, 1.0, 60), 1.0 - 1e-4, 1.0 - 1e-8, 2.0, 0.5):
            q = first.copy()
            mujoco.mj_integratePos(model, q, apart, float(share))
            yield q


@pytest.mark.parametrize("adapt", ["sigma_min", "manipulability"])
@pytest.mark.parametrize("case", CASES)
def test_the_damping_is_that_of_numpys_singular_values(case: str, adapt: str) -> None:
    problem = problem_of(case, adapt)
    ours, theirs = (rmrc.Controller(problem, engine=engine) for engine in ("native", "python"))
    found = []
    for q in configurations(problem.model, problem.start):
        ours.step(q)
        theirs.step(q)
        expected = theirs.engine.assembly.adaptive.added.item()
        assert ours.engine.assembly.adaptive.added.item() == pytest.approx(
            expected, abs=SAME * LARGEST**2
        )
        found.append(expected)
    assert min(found) == 0.0
    assert max(found) > 0.1 * LARGEST**2


def test_the_way_to_a_configuration_makes_no_difference() -> None:
    """What is remembered of other configurations saves work, and changes no bit."""
    problem = problem_of("more dofs than rows", "sigma_min")
    walker = rmrc.Controller(problem, engine="native")
    for k, q in enumerate(configurations(problem.model, problem.start)):
        walker.step(q)
        if k % 7 == 0:
            new = rmrc.Controller(problem, engine="native")
            new.step(q)
            added = [each.engine.assembly.adaptive.added.item() for each in (walker, new)]
            assert added[0] == added[1]
