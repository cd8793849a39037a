"""Drives that lag: a joint stops at its limit all the same, and rests there."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import config
from rmrc.control.engines import Choice

Array = NDArray[np.float64]

SLIDE = """<mujoco><worldbody>
  <body>
    <joint name="x" type="slide" axis="1 0 0" range="-1 1"/><geom size="0.1"/><site name="hand"/>
  </body></worldbody></mujoco>"""
FASTEST = 1.5
"""m/s."""
SECONDS = 8.0
ROUNDING = 1e-9
"""m; what a sum of thousands of steps leaves."""
SAME = 1e-6
"""m between the engines: rounding, over hundreds of steps."""
KNOWN_WITHIN = 0.3
"""Share by which a lag may be known wrongly."""
OVER = 0.025
"""m beyond the limit where the lag is a third longer than was said, for 100 ms."""
PASSED = 0.12
"""m beyond the limit with a lag of 100 ms that nobody told of: less than 1.5 m/s go in it."""
SETTLES = 2e-3
"""m that a joint may move in the last second."""


def run(
    folder: Path, drive: float, dt: float, acceleration: float, engine: Choice, **others: Any
) -> tuple[Array, Array]:
    """Return the positions and the commands of a slide whose target is far beyond its limit.

    The drive is of first order, v' = (u − v)/T, integrated exactly.
    """
    (folder / "slide.xml").write_text(SLIDE)
    limits = {"velocity": {"default": FASTEST}, "acceleration": {"default": acceleration}}
    task = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
    made = config(str(folder / "slide.xml"), [task], dt=dt, limits=limits, **others)
    controller = rmrc.Controller(rmrc.compile(made), engine)
    assert controller.set_target("hand", position=[3.0, 0.0, 0.0])
    q, v, share = 0.0, 0.0, 1.0 - np.exp(-dt / drive)
    places, commands = [], []
    for _ in range(round(SECONDS / dt)):
        u = float(controller.step(np.array([q]), v=np.array([v])).v[0])
        q += u * dt + (v - u) * drive * share
        v += share * (u - v)
        places.append(q)
        commands.append(u)
    return np.array(places), np.array(commands)


@pytest.mark.parametrize("lag", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.parametrize("acceleration", [1.0, 10.0, 50.0])
def test_a_known_lag_costs_nothing(
    tmp_path: Path, lag: float, dt: float, acceleration: float
) -> None:
    """The joint arrives at its limit without passing it, and keeps its acceleration."""
    places, commands = run(tmp_path, lag, dt, acceleration, "auto", lag={"default": lag})
    assert places.max() <= 1.0 + ROUNDING
    assert places[-1] == pytest.approx(1.0, abs=1e-3)
    assert np.abs(np.diff(commands)).max() <= acceleration * dt + ROUNDING


@pytest.mark.parametrize("share", [1.0 - KNOWN_WITHIN, 1.0 + KNOWN_WITHIN])
@pytest.mark.parametrize("acceleration", [1.0, 10.0, 50.0])
def test_a_lag_that_is_known_roughly(tmp_path: Path, share: float, acceleration: float) -> None:
    places, _ = run(tmp_path, 0.1, 0.002, acceleration, "auto", lag={"default": 0.1 * share})
    assert places.max() <= 1.0 + OVER
    assert np.ptp(places[-500:]) <= SETTLES


@pytest.mark.parametrize("lag", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.parametrize("acceleration", [10.0, 50.0])
def test_a_lag_that_nobody_told_of(
    tmp_path: Path, lag: float, dt: float, acceleration: float
) -> None:
    """The command goes on slowing down from where it was, and the joint settles at its limit."""
    places, _ = run(tmp_path, lag, dt, acceleration, "auto", previous="measured")
    assert places.max() <= 1.0 + PASSED
    assert np.ptp(places[-round(1.0 / dt) :]) <= SETTLES


def test_both_engines_know_the_lag(tmp_path: Path) -> None:
    lag: dict[str, Any] = {"lag": {"x": 0.05}}
    engines: tuple[Choice, ...] = ("python", "auto")
    runs = [run(tmp_path, 0.05, 0.01, 10.0, engine, **lag)[0] for engine in engines]
    np.testing.assert_allclose(runs[0], runs[1], atol=SAME)


def test_a_perfect_drive_makes_measured_what_is_commanded(tmp_path: Path) -> None:
    runs = [
        run(tmp_path, 1e-9, 0.01, 10.0, "python", previous=previous)[0]
        for previous in ("commanded", "measured")
    ]
    np.testing.assert_allclose(runs[0], runs[1], atol=ROUNDING)


def test_a_lag_of_a_joint_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(rmrc.ConfigError, match=r"lag\.y: no joint named 'y'"):
        run(tmp_path, 0.1, 0.01, 10.0, "auto", lag={"y": 0.1})
