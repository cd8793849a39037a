"""What the native engine evaluates of `loop` tasks, and which steps it takes as a whole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config

pytest.importorskip(
    "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
)
from twins import twins

from rmrc.control.batch import BatchController
from rmrc.control.fast.steps import Taken
from rmrc.native.engine import NativeEngine

ROUNDING = 1e-12
"""m or rad, and of J: sums of a few terms of the order of 1, in another order."""

STEPS = 200
TAKEN = 0.9
"""Share of the steps that C++ ends: targets out of reach for hard tasks go down the ladder."""
START = [0.3, -0.4, 0.5, -1.8, 0.4, 1.7, 0.6]
PANDA = str(REPOSITORY / "scenes" / "panda.xml")

MECHANISM = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <default><geom size="0.02" mass="0.1"/></default>
  <worldbody>
    <body name="still" pos="0.1 0.2 0.3"><geom/><site name="wall" euler="20 30 40"/></body>
    <body name="base"><joint name="slide" type="slide" axis="1 0 0"/><geom/>
      <body name="left" pos="0.3 0 0">
        <joint name="l1" axis="0 0 1"/><joint name="l2" axis="0 1 0"/><geom/>
        <site name="on_left" pos="0.1 0.2 0" euler="10 0 50"/>
        <body name="tip" pos="0.2 0 0.1"><joint name="l3" axis="1 0 0"/><geom/></body>
      </body>
      <body name="right" pos="-0.3 0 0">
        <joint name="r1" axis="0 0 1"/><joint name="r2" type="ball"/><geom/>
        <site name="on_right" pos="0 0.1 0.2" euler="0 70 10"/>
      </body>
    </body>
    <body name="free" pos="0 0 1"><freejoint/><geom/></body>
  </worldbody>
  <tendon>
    <fixed name="sum"><joint joint="l1" coef="1"/><joint joint="r1" coef="-0.5"/></fixed>
    <fixed name="other"><joint joint="l3" coef="2"/></fixed>
    {spatial}
  </tendon>
  <equality>
    <connect name="point" body1="tip" body2="right" anchor="0.1 0 0.2"/>
    <connect name="sites" site1="on_left" site2="on_right"/>
    <connect name="ground" body1="free" anchor="0 0.1 0"/>
    <connect name="nothing" body1="still" anchor="0.1 0 0"/>
    <weld name="welded" body1="left" body2="free" relpose="0.1 0 0.2 0.6 0 0.8 0"
      torquescale="0.7"/>
    <weld name="frames" site1="on_right" site2="wall"/>
    <joint name="curve" joint1="l1" joint2="slide" polycoef="0.1 0.5 -0.3 0.2 0.4"/>
    <joint name="value" joint1="l2" polycoef="0.3 0 0 0 0"/>
    <tendon name="ropes" tendon1="sum" tendon2="other" polycoef="0.1 0.7 0.2 0 0"/>
    <tendon name="rope" tendon1="{tendon}" polycoef="0.05 0 0 0 0"/>
  </equality>
</mujoco>
"""
SPATIAL = '<spatial name="path"><site site="wall"/><site site="on_left"/></spatial>'
CONSTRAINTS = ["ropes", "welded", "point", "nothing", "curve", "sites", "ground", "value"]
CONSTRAINTS += ["frames", "rope"]


def mechanism(folder: Path, jacobian: str = "dense", tendon: str = "sum") -> rmrc.Problem:
    """Return a problem with every kind of constraint, as soft tasks."""
    scene = folder / "mechanism.xml"
    spatial = SPATIAL if tendon == "path" else ""
    scene.write_text(MECHANISM.format(jacobian=jacobian, tendon=tendon, spatial=spatial))
    tasks: list[dict[str, Any]] = [
        {"name": name, "type": "loop", "equalities": [name], "hard": False, "gain": 2.0}
        for name in CONSTRAINTS
    ]
    return rmrc.compile(config(str(scene), tasks, damping={"lambda": 0.1}))


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_every_kind_of_constraint_is_evaluated_as_in_mujoco(tmp_path: Path, jacobian: str) -> None:
    problem = mechanism(tmp_path, jacobian)
    python, native = (rmrc.Controller(problem, engine=e).engine for e in ("python", "native"))
    assert isinstance(native, NativeEngine)
    assert not native._foreign
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = rng.normal(size=problem.model.nq)
        for first in (5, 12):  # the quaternions of the ball and of the free body
            q[first : first + 4] /= np.linalg.norm(q[first : first + 4])
        for engine in (python, native):
            engine.prepare(q, np.zeros(problem.model.nv), problem.dt)
        ours, theirs = native.evaluation, python.evaluation
        np.testing.assert_allclose(ours.error, theirs.error, rtol=0.0, atol=ROUNDING)
        np.testing.assert_allclose(ours.jacobian, theirs.jacobian, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ({"hard": True}, {}),
        ({}, {"priority": "strict"}),
        ({"preserve": "direction"}, {}),
        ({"hard": True}, {"priority": "strict"}),
    ],
)
def test_nearly_all_steps_end_in_the_extension(
    task: dict[str, Any], options: dict[str, Any]
) -> None:
    point = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "gain": 2.0}
    point["B"] = {"position": 1.0, "orientation": 0.0}
    below = {"name": "posture", "type": "posture", "level": 1, "B": 0.01}
    limits = {"velocity": {"default": 0.6}}
    tasks = [{**point, **task}, below]
    problem = rmrc.compile(config(PANDA, tasks, start=START, dt=0.005, limits=limits, **options))
    taken = [isinstance(native._source, Taken) for _, native in twins(problem, STEPS)]
    assert sum(taken) >= TAKEN * STEPS


@pytest.mark.parametrize(("hard", "priority"), [(True, "soft"), (False, "strict")])
def test_a_batch_takes_the_steps_of_one(hard: bool, priority: str) -> None:
    point = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "hard": hard}
    tasks = [point, {"name": "posture", "type": "posture", "level": 1, "B": 0.01}]
    limits = {"velocity": {"default": 0.6}}
    problem = rmrc.compile(config(PANDA, tasks, start=START, limits=limits, priority=priority))
    far = problem.term["hand"].target[4:] + np.array(
        [1.0, 0.0, 0.5]
    )  # hard, it goes down the ladder
    batch, alone = BatchController(problem, 1), rmrc.Controller(problem)
    assert batch.set_targets("hand", np.array([[*far, 1.0, 0.0, 0.0, 0.0]])).all()
    assert alone.set_target("hand", far, [1.0, 0.0, 0.0, 0.0])
    for _ in range(20):
        np.testing.assert_array_equal(batch.step().v[0], alone.step().v)


def test_a_tendon_with_a_path_stays_with_python(tmp_path: Path) -> None:
    for _, native in twins(mechanism(tmp_path, tendon="path"), 20):
        engine = native.moment.engine
        assert isinstance(engine, NativeEngine)
        assert engine._foreign
        assert not isinstance(native._source, Taken)
