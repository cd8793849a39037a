"""Random robots, tasks and moments that the identities are held on."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from hypothesis import Phase, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config, random_configuration

Array = NDArray[np.float64]

ROBOTS = ("planar", "panda", "ur5e", "biped")
"""A planar arm of random links, and the scenes of the same names."""
OFF = {"position": "off", "velocity": "off"}
"""No limits at all."""

HANDS = {
    "planar": ("hand", {"body": "link1"}),
    "panda": ("hand", {"body": "link4"}),
    "ur5e": ("tool", {"body": "forearm_link"}),
    "biped": ("left_hand", {"site": "head"}),
}
"""The site of each robot's hand, and another frame of it."""

numbers = st.integers(0, 2**31)
each_robot = pytest.mark.parametrize("robot", ROBOTS)


def examples(count: int):
    """Return the decorator of a property: seeded, and without a deadline that load could break.

    What fails is not shrunk: most of an example hangs on the seed of a generator.
    """
    options = settings(max_examples=count, deadline=None, phases=[Phase.explicit, Phase.generate])
    return lambda test: seed(0)(options(test))


@dataclass(frozen=True)
class Robot:
    """A robot and the rows of its hand's pose that a task asks for."""

    scene: str
    site: str
    root: dict[str, str]
    """Another frame of the robot."""
    rows: tuple[int, ...]
    """Of [position; orientation], as many as the robot can move at once."""
    joints: int
    """Number of hinges."""

    def hand(self, weight: Array | None = None, **others: Any) -> dict[str, Any]:
        """Return a task on the rows of the hand, of weight 1 or of a matrix over the rows."""
        if weight is None:
            full = [float(row in self.rows) for row in range(6)]
        else:
            full = np.zeros((6, 6))
            full[np.ix_(self.rows, self.rows)] = weight
        frame = {"site": self.site}
        return {"name": "hand", "type": "frame", "frame": frame, "B": full, **others}

    def controller(self, *tasks: dict[str, Any], **others: Any) -> rmrc.Controller:
        """Return a controller without limits, damping and curvature, unless the options say so."""
        damping = {"lambda": 0.0, "curvature": "off", **others.pop("damping", {})}
        options = {"limits": OFF, "damping": damping, **others}
        return rmrc.Controller(rmrc.compile(config(self.scene, list(tasks), **options)))

    def asking(self, *rows: int) -> "Robot":
        """Return the same robot with other rows."""
        return replace(self, rows=rows)


def planar_arm(lengths: Array, folder: Path) -> Robot:
    """Return an arm in the plane z = 0 of links of the given lengths, m."""
    body = f'<site name="hand" pos="{lengths[-1]} 0 0"/>'
    for k in range(len(lengths), 0, -1):
        length, offset = lengths[k - 1], lengths[k - 2] if k > 1 else 0.0
        body = (
            f'<body name="link{k}" pos="{offset} 0 0">'
            f'<joint name="joint{k}" axis="0 0 1" range="-2.9 2.9"/>'
            f'<geom type="capsule" size="0.03" fromto="0 0 0 {length} 0 0"/>{body}</body>'
        )
    text = (
        '<mujoco><compiler angle="radian"/><option integrator="implicitfast"/>'
        f"<worldbody>{body}</worldbody></mujoco>"
    )
    path = folder / f"planar_{'_'.join(f'{length:.17g}' for length in lengths)}.xml"
    path.write_text(text)
    rows = (0, 1) if len(lengths) == 2 else (0, 1, 5)
    return Robot(str(path), *HANDS["planar"], rows, len(lengths))


def unit_links(count: int) -> Robot:
    """Return the scene of a planar arm of 2, 3 or 4 links of 1 m."""
    scene = str(REPOSITORY / "scenes" / f"planar_{count}r.xml")
    return Robot(scene, *HANDS["planar"], (0, 1), count)


def random_robot(name: str, rng: np.random.Generator, folder: Path) -> Robot:
    """Return a robot that is asked for a position or for a whole pose; a planar arm of 2 to 6."""
    if name == "planar":
        robot = planar_arm(rng.uniform(0.3, 1.2, rng.integers(2, 7)), folder)
        return robot if rng.integers(2) else robot.asking(0, 1)
    scene = str(REPOSITORY / "scenes" / f"{name}.xml")
    rows = range(6 if rng.integers(2) else 3)
    return Robot(scene, *HANDS[name], tuple(rows), {"panda": 7, "ur5e": 6, "biped": 25}[name])


def definite(rng: np.random.Generator, size: int) -> Array:
    """Return a symmetric positive definite matrix of a condition of about 100."""
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    return root @ root.T + 0.05 * np.eye(size)


@dataclass(frozen=True)
class Moment:
    """Where the robot is, where its hand should be and how fast that moves."""

    q: Array
    target: mink.SE3
    velocity: Array | None

    def step(self, controller: rmrc.Controller) -> rmrc.Step:
        """Return a controller's step at this moment."""
        position, quaternion = self.target.translation(), self.target.rotation().wxyz
        assert controller.set_target("hand", position, quaternion, self.velocity)
        return controller.step(self.q)


def random_moment(controller: rmrc.Controller, rng: np.random.Generator) -> Moment:
    """Return a moment about 0.2 m and 0.4 rad away from the target."""
    problem = controller.problem
    q = random_configuration(problem.model, problem.start, rng, 0.6)
    pose = mink.SE3.from_matrix(problem.forward(q)["hand"])
    turn = mink.SO3.exp(0.25 * rng.normal(size=3)) @ pose.rotation()
    position = pose.translation() + 0.1 * rng.normal(size=3)
    target = mink.SE3.from_rotation_and_translation(turn, position)
    return Moment(q, target, 0.3 * rng.normal(size=6))


def asked(controller: rmrc.Controller, name: str = "hand") -> tuple[Array, Array]:
    """Return J (m, n) and ẋ (m,) of a task's weighed rows at the last step."""
    engine, term = controller.engine, controller.problem.term[name]
    weight = term.weight if term.weight.ndim == 1 else np.diagonal(term.weight)
    rows = engine.evaluation.rows_of([term]).start + np.flatnonzero(weight)
    columns = controller.problem.dofs
    return engine.evaluation.jacobian[np.ix_(rows, columns)], engine.assembly.rate[rows]


def assert_close(actual: Array, expected: Array, tolerance: float) -> None:
    """Assert that no entry is off by more than a share of the largest, or of 1."""
    size = max(1.0, float(np.abs(expected).max()))
    assert np.abs(actual - expected).max() <= tolerance * size
