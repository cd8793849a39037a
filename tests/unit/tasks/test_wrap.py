"""`wrap: true` of a posture: hinges without a range take the short way round."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import config

CHAIN = """<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="endless" axis="0 0 1"/><geom size="0.03"/>
    <body pos="0.1 0 0"><joint name="ranged" axis="0 0 1" range="-4 4" limited="true"/>
      <geom size="0.03"/>
      <body pos="0.1 0 0"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.03"/>
        <body pos="0.1 0 0"><joint name="given" axis="0 0 1"/><geom size="0.03"/>
          <body pos="0.1 0 0"><joint name="ball" type="ball"/><geom size="0.03"/></body>
        </body></body></body></body>
</worldbody></mujoco>"""
JOINTS = ("endless", "ranged", "slide", "given")
FAR = 3.0
DT = 0.01
SAME = 1e-9
"""What the damping and rounding leave of a command's direction, rad/s."""


def first_errors(tmp_path: Path, engine: Any, start: float, target: float, **keys: Any) -> Any:
    """Return the error of the posture and the joint rates at the first step."""
    scene = tmp_path / "chain.xml"
    scene.write_text(CHAIN)
    task = {
        "name": "posture",
        "type": "posture",
        "gain": 1.0,
        "target": dict.fromkeys(JOINTS, target),
        **keys,
    }
    made = config(
        str(scene),
        [task],
        start=dict.fromkeys(JOINTS, start),
        dt=DT,
        limits={"position": {"given": [-5.0, 5.0]}, "velocity": "off"},
        damping={"lambda": 1e-6},
    )
    controller = rmrc.Controller(rmrc.compile(made), engine)
    step = controller.step()
    return step.moment.error.copy(), step.v


def test_only_hinges_without_a_range_wrap(tmp_path: Path, engine: Any) -> None:
    error, v = first_errors(tmp_path, engine, -FAR, FAR, wrap=True)
    short, long = 2.0 * FAR - 2.0 * np.pi, 2.0 * FAR
    np.testing.assert_allclose(error[:4], [short, long, long, long], rtol=0.0, atol=SAME)
    np.testing.assert_allclose(error[4:], 0.0, atol=SAME)
    np.testing.assert_allclose(v[:4], error[:4], rtol=1e-6)


def test_without_it_nothing_wraps(tmp_path: Path, engine: Any) -> None:
    error, _ = first_errors(tmp_path, engine, -FAR, FAR)
    np.testing.assert_allclose(error[:4], 2.0 * FAR, rtol=0.0, atol=SAME)


@pytest.mark.parametrize("turns", [-3, -1, 0, 2])
@pytest.mark.parametrize("left", [-3.0, 0.0, 1.0, np.pi])
def test_any_number_of_turns_is_none(tmp_path: Path, engine: Any, turns: int, left: float) -> None:
    error, _ = first_errors(tmp_path, engine, 0.0, left + 2.0 * np.pi * turns, wrap=True)
    assert -np.pi < error[0] <= np.pi
    # Half a turn is as long either way: rounding may choose.
    assert np.cos(error[0]) == pytest.approx(np.cos(left), abs=SAME)
    assert np.sin(error[0]) == pytest.approx(np.sin(left), abs=SAME)
