"""With the curvature in the program the robot rests where it cannot go, and arrives elsewhere."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import config

Array = NDArray[np.float64]

SECONDS = 10.0
RESTS = {0.0005: 1e-3, 0.002: 1e-3, 0.02: 1e-2, 0.1: 1e-2}
"""Largest rate at the end, rad/s, by dt."""
ROUNDING = 1e-12
"""What V may rise by near 0, in its own unit."""
SHAKES = 1e-6
"""A rate below this, rad/s, has no sign: what the posture leaves changes it now and then."""
RISE = 1e-9
"""Share of V that rounding may add."""
BEYOND = ([1.4, 0.2, 0.4], [0.9, 0.3, 0.9], [99.0, 0.0, 0.4], [1e6, 0.0, 0.4])
INSIDE = ([0.5, 0.2, 0.4], [0.3, -0.4, 0.6], [0.4, 0.3, 0.2])
SAME = 1e-8
"""Relative difference of the engines' rates."""
ARRIVED = 1e-3
"""m."""
SLOWER = 1.1
"""Times that X may make the way to a target inside the workspace longer."""
OVERSHOOT = 0.01
"""Share of the way that may be passed."""

SLIDE = """<mujoco><worldbody>
  <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1"/><site name="hand"/></body>
</worldbody></mujoco>"""


def panda(repository: Path, dt: float, curvature: bool = True, **others: Any) -> rmrc.Problem:
    tasks: list[dict[str, Any]] = [
        {"name": "hand", "type": "frame", "frame": {"site": "hand"}},
        {"name": "posture", "type": "posture", "level": 1, "B": 0.01, "gain": 1.0},
    ]
    return rmrc.compile(
        config(
            str(repository / "scenes" / "panda.xml"),
            tasks,
            start="home",
            dt=dt,
            damping={"curvature": curvature},
            **others,
        )
    )


def potential(controller: rmrc.Controller) -> float:
    """Return V = Σ K ½ eᵀBe, with the weights in use."""
    engine, total = controller.engine, 0.0
    for term in engine.evaluation.terms:
        error = engine.evaluation.error_of(engine.evaluation.error, term)
        gain = min(term.gain, 1.0 / engine.problem.dt)
        total += 0.5 * gain * float(error @ (engine.assembly.leveled(term) * error))
    return total


def sign_changes(rates: Array) -> int:
    """Return how often a joint's rate changes its sign, at most (N, n)."""
    signs = np.sign(np.where(np.abs(rates) < SHAKES, 0.0, rates))
    return int((np.diff(signs, axis=0) != 0.0).sum(axis=0).max())


@pytest.mark.parametrize("dt", RESTS)
@pytest.mark.parametrize("target", BEYOND)
def test_it_rests_where_it_cannot_go(repository: Path, target: list[float], dt: float) -> None:
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    controller = rmrc.Controller(panda(repository, dt), "native")
    controller.set_target("hand", position=target)
    rates = np.array([controller.step().v for _ in range(round(SECONDS / dt))])
    last = rates[-max(10, round(1.0 / dt)) :]
    assert sign_changes(last) <= 1
    # What the posture still asks for in the null space decays at its own rate.
    assert np.abs(rates[-1]).max() < 2.0 * RESTS[dt]


@pytest.mark.parametrize("target", [*BEYOND, *INSIDE])
@pytest.mark.parametrize("dt", [0.002, 0.05])
def test_the_potential_does_not_rise(repository: Path, target: list[float], dt: float) -> None:
    controller = rmrc.Controller(panda(repository, dt), "python")
    controller.set_target("hand", position=target)
    values = []
    for _ in range(300):
        controller.step()
        values.append(potential(controller))
    rises = np.diff(values) - RISE * np.abs(values[:-1])
    assert rises.max() <= ROUNDING


@pytest.mark.parametrize("target", INSIDE)
def test_little_is_lost_near(repository: Path, target: list[float], engine: Any) -> None:
    times = []
    for curvature in (False, True):
        problem = panda(repository, 0.002, curvature)
        controller = rmrc.Controller(problem, engine)
        controller.set_target("hand", position=target)
        for k in range(2000):
            controller.step()
            place = problem.forward(controller.q)["hand"][:3, 3] if k % 5 == 0 else None
            if place is not None and np.linalg.norm(place - target) < ARRIVED:
                times.append(k)
                break
    assert len(times) == 2
    assert times[1] <= SLOWER * times[0]


@pytest.mark.parametrize(
    ("acceleration", "jerk", "gain"),
    [(20.0, None, 20.0), (1.0, None, 20.0), (20.0, 1000.0, 10.0), (1.8, 2.0, 10.0)],
)
def test_a_slide_stops_at_its_target(
    tmp_path: Path, engine: Any, acceleration: float, jerk: float | None, gain: float
) -> None:
    (tmp_path / "slide.xml").write_text(SLIDE)
    limits: dict[str, Any] = {
        "velocity": {"default": 1.5},
        "acceleration": {"default": acceleration},
    }
    if jerk is not None:
        limits["jerk"] = {"default": jerk}
    task = {
        "name": "hand",
        "type": "frame",
        "frame": {"site": "hand"},
        "B": {"position": 1.0, "orientation": 0.0},
        "gain": gain,
    }
    problem = rmrc.compile(
        config(
            str(tmp_path / "slide.xml"),
            [task],
            dt=0.004,
            limits=limits,
            damping={"curvature": True},
        )
    )
    controller = rmrc.Controller(problem, engine)
    controller.set_target("hand", position=[3.0, 0.0, 0.0])
    places = np.array([controller.step().q[0] for _ in range(2500)])
    assert places.max() <= 3.0 * (1.0 + OVERSHOOT)
    assert abs(places[-1] - 3.0) < ARRIVED


@pytest.mark.parametrize(
    "others",
    [
        {},
        {"priority": "strict"},
        {"limits": {"acceleration": {"default": 10.0}}},
        {"limits": {"acceleration": {"default": 10.0}, "jerk": {"default": 200.0}}},
        {"priority": "strict", "limits": {"acceleration": {"default": 10.0}}},
    ],
)
def test_both_engines_take_the_same_steps(repository: Path, others: dict[str, Any]) -> None:
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    problem = panda(repository, 0.002, **others)
    python, native = rmrc.Controller(problem, "python"), rmrc.Controller(problem, "native")
    rng, q = np.random.default_rng(0), problem.start.copy()
    for k in range(200):
        if k % 40 == 0:
            target = rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.2])
            assert python.set_target("hand", position=target)
            assert native.set_target("hand", position=target)
        one, other = python.step(q), native.step(q)
        assert other.v == pytest.approx(one.v, rel=SAME, abs=SAME)
        q = one.q


def planar_chain(links: int) -> str:
    """Return a chain of hinges in a plane, 1 m long, with a site `hand` at its end."""
    length = 1.0 / links
    opened = "".join(
        f'<body pos="{length if k else 0.0} 0 0"><joint name="j{k}" axis="0 0 1"/>'
        f'<geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.01" contype="0"/>'
        for k in range(links)
    )
    site = f'<site name="hand" pos="{length} 0 0"/>'
    return f"<mujoco><worldbody>{opened}{site}{'</body>' * links}</worldbody></mujoco>"


POINT = {"B": {"position": 1.0, "orientation": 0.0}}
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "soft": ({}, {}),
    "strict": ({}, {"priority": "strict"}),
    "hard": ({"hard": True}, {}),
    "hard point": ({"hard": True, **POINT}, {}),
    "direction": ({"preserve": "direction"}, {}),
    "direction of a point": ({"preserve": "direction", **POINT}, {}),
    "strict, acceleration": (
        {},
        {"priority": "strict", "limits": {"acceleration": {"default": 10.0}}},
    ),
}
CREEPS = 1e-4
"""A rate below this, rad/s, has no sign: what a lower task still asks for changes it."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("links", [2, 7, 12, 30])
@pytest.mark.parametrize("target", [[1.05, 0.5, 0.0], [20.0, -45.0, 0.0]])
def test_a_chain_rests_however_its_hand_is_asked(
    tmp_path: Path, kind: str, links: int, target: list[float]
) -> None:
    """No joint of it shakes at the end, and it slows down to the rate of the lower task."""
    pytest.importorskip(
        "rmrc._native", reason="the native extension is not built", exc_type=ImportError
    )
    (tmp_path / "chain.xml").write_text(planar_chain(links))
    own, others = KINDS[kind]
    tasks = [
        {"name": "hand", "type": "frame", "frame": {"site": "hand"}, **own},
        {"name": "posture", "type": "posture", "level": 1, "B": 0.01},
    ]
    problem = rmrc.compile(config(str(tmp_path / "chain.xml"), tasks, dt=0.002, **others))
    controller = rmrc.Controller(problem, "native")
    assert controller.set_target("hand", position=target)
    rates = np.array([controller.step().v for _ in range(10_000)])
    last = np.where(np.abs(rates[-500:]) < CREEPS, 0.0, rates[-500:])
    assert sign_changes(last) <= 1
    assert np.abs(rates[-1]).max() <= max(1e-3, np.abs(rates[-500]).max())


@pytest.mark.parametrize("kind", ["coupling", "kinetic_energy"])
def test_levels_of_nothing_that_bends(repository: Path, engine: Any, kind: str) -> None:
    """A strict problem may have no level with rows at all."""
    tasks: dict[str, dict[str, Any]] = {
        "coupling": {"coefficients": {"joint1": 1.0, "joint2": -1.0}, "hard": True},
        "kinetic_energy": {},
    }
    task = {"name": "alone", "type": kind, **tasks[kind]}
    scene = str(repository / "scenes" / "panda.xml")
    problem = rmrc.compile(config(scene, [task], priority="strict"))
    controller = rmrc.Controller(problem, engine)
    assert all(np.isfinite(controller.step().v).all() for _ in range(3))


def test_a_step_of_next_to_no_time(repository: Path, engine: Any) -> None:
    """What a level cannot get is found at every dt, though dt² is lost beside W Wᵀ."""
    controller = rmrc.Controller(panda(repository, 0.002, priority="strict"), engine)
    controller.set_target("hand", position=[2.0, 0.0, 0.4])
    for _ in range(2000):
        controller.step()
    assert np.isfinite(controller.step(dt=1e-12).v).all()
