"""Every type of task, limit and equality is in both engines alike, or listed as Python's alone."""

from typing import Any, get_args

import mujoco
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc.limits.models import LimitsModel
from rmrc.tasks import Task
from rmrc.text.annotations import tagged

pytest.importorskip(
    "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
)
from twins import assert_equal

from rmrc.native.engine import NativeEngine
from rmrc.native.kinematics import Watched

STEPS = 60
PYTHONS = {"manipulability", "clearance"}
"""Types of tasks that Python evaluates for the native engine."""

SCENE = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -0.6"/>
    <body name="base" pos="0 0 0.1"><freejoint name="root"/><geom size="0.05"/>
      <body name="upper" pos="0.1 0 0">
        <joint name="one" axis="0 0 1" range="-2 2" limited="true"/>
        <geom name="upper" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
        <site name="elbow" pos="0.3 0 0"/>
        <body name="lower" pos="0.3 0 0">
          <joint name="two" axis="0 1 0.2" range="-2 2" limited="true"/>
          <geom name="lower" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
          <body name="tip" pos="0.3 0 0"><joint name="ball" type="ball" range="0 0.9"/>
            <geom name="tip" type="capsule" fromto="0 0 0 0.1 0.05 0" size="0.02"/>
            <site name="hand" pos="0.1 0.05 0"/>
          </body>
        </body>
      </body>
      <body name="other" pos="-0.1 0 0">
        <joint name="three" axis="0 1 0" range="-2 2" limited="true"/>
        <geom name="other" type="capsule" fromto="0 0 0 -0.3 0 0" size="0.02"/>
        <site name="end" pos="-0.3 0 0"/>
      </body>
    </body>
    <body name="anchor" pos="-0.42 0 0.1"><site name="anchor"/></body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="one" coef="1"/><joint joint="three" coef="0.5"/></fixed>
    <spatial name="string"><site site="elbow"/><site site="end"/></spatial>
  </tendon>
  <actuator>
    <motor joint="one"/><motor joint="two"/><motor joint="three"/>
  </actuator>
  <equality>
    <connect name="connect" body1="other" body2="anchor" anchor="-0.3 0 0"/>
    <weld name="weld" body1="base" body2="anchor"/>
    <joint name="joint" joint1="one" joint2="three" polycoef="0.1 0.5 0 0 0"/>
    <tendon name="tendon" tendon1="both"/>
    <tendon name="spatial tendon" tendon1="string"/>
  </equality>
</mujoco>
"""
HAND: dict[str, Any] = {"type": "frame", "frame": {"site": "hand"}}
REST: dict[str, Any] = {"name": "rest", "type": "posture", "level": 1}
END = {"site": "end"}

TASKS: dict[str, dict[str, Any]] = {
    "frame": HAND,
    "relative_frame": {"frame": {"site": "hand"}, "root": END},
    "com": {},
    "posture": {"target": {"one": 0.4, "three": -0.3}},
    "velocity": {"target": {"one": 0.1}},
    "smooth": {"B": 0.1},
    "kinetic_energy": {"B": 0.1},
    "look_at": {"frame": END, "target": [1.0, 0.5, 0.3]},
    "axis_align": {"frame": END, "target": [0.3, 0.2, 1.0]},
    "coupling": {"coefficients": {"one": 1.0, "three": -0.5}, "offset": 0.1},
    "loop": {"equalities": ["connect"]},
    "manipulability": {"frame": {"site": "hand"}, "B": 0.1},
    "centering": {"B": 0.1},
    "clearance": {"pairs": [["lower", "other"]], "distance": 0.6},
    "freeze": {"joints": ["two"]},
}
SLOW = {"default": 0.5}
LIMITS: dict[str, Any] = {
    "position": {"margin": 0.3},
    "velocity": SLOW,
    "acceleration": {"default": 3.0},
    "jerk": {"default": 60.0},
    "base": {"linear": 0.2, "angular": 0.3},
    "speed": {"hand": {"linear": 0.3, "angular": 0.5}},
    "workspace": [{"frame": {"site": "hand"}, "normal": [0, 0, 1], "offset": 0.0}],
    "collision": {"pairs": [["lower", "other"], ["lower", "floor"]], "d_min": 0.05, "detect": 0.4},
}
EQUALITIES = {
    mujoco.mjtEq.mjEQ_CONNECT: ["connect"],
    mujoco.mjtEq.mjEQ_WELD: ["weld"],
    mujoco.mjtEq.mjEQ_JOINT: ["joint"],
    mujoco.mjtEq.mjEQ_TENDON: ["tendon", "spatial tendon"],
}
WITHOUT = {"mjEQ_DISTANCE", "mjEQ_FLEX", "mjEQ_FLEXVERT", "mjEQ_FLEXSTRAIN"}
"""Types of equalities that no task holds: of flexes, and one that MuJoCo has dropped."""


@pytest.fixture
def scene(tmp_path: Any) -> str:
    (tmp_path / "scene.xml").write_text(SCENE)
    return str(tmp_path / "scene.xml")


def test_every_type_is_listed() -> None:
    assert set(TASKS) == set(tagged(Task))
    assert set(LIMITS) == set(LimitsModel.model_fields)
    types = {name for name in dir(mujoco.mjtEq) if name.startswith("mjEQ_")}
    assert {kind.name for kind in EQUALITIES} == types - WITHOUT


def compared(made: rmrc.Config) -> NativeEngine:
    """Hold the native engine to the Python one over a run, and return one."""
    problem = rmrc.compile(made)
    assert_equal(problem, STEPS, moving=True)
    return NativeEngine(problem)


@pytest.mark.parametrize("priority", ["soft", "strict"])
@pytest.mark.parametrize("kind", TASKS)
def test_a_task(kind: str, priority: str, scene: str) -> None:
    task = {"name": "task", "type": kind, **TASKS[kind]}
    tasks = [task, {"name": "hand", **HAND, "B": 0.1}, REST]
    engine = compared(config(scene, tasks, dt=0.01, priority=priority, equalities="off"))
    foreign = {term.type for term in engine.evaluation.terms if type(term) in dict(engine._foreign)}
    assert foreign == PYTHONS & {kind}


@pytest.mark.parametrize("kind", LIMITS)
def test_a_limit(kind: str, scene: str) -> None:
    tasks = [{"name": "hand", **HAND}, REST]
    compared(config(scene, tasks, dt=0.01, limits={kind: LIMITS[kind]}, equalities="off"))


@pytest.mark.parametrize("name", [name for names in EQUALITIES.values() for name in names])
def test_an_equality(name: str, scene: str) -> None:
    tasks = [{"name": "loop", "type": "loop", "equalities": [name]}, {"name": "hand", **HAND}, REST]
    engine = compared(config(scene, tasks, dt=0.01, equalities="off"))
    assert bool(engine._foreign) == (name == "spatial tendon")


PLACED = {"frame", "relative_frame", "com", "look_at", "axis_align", "loop"}
"""Types of tasks that C++ evaluates from poses: from no others do they come."""
ABSENT = "is none of what the kinematics place"


def built(scene: str, *tasks: dict[str, Any], limits: dict[str, Any] | None = None) -> None:
    made = config(scene, list(tasks), dt=0.01, limits=limits or {}, equalities="off")
    NativeEngine(rmrc.compile(made))


@pytest.mark.parametrize("kind", TASKS)
def test_a_task_that_is_not_registered_is_an_error(
    kind: str, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No pose is read that the native kinematics do not place, whatever Python has forgotten."""
    monkeypatch.setattr(Watched, "add_term", lambda *_: None)
    task = {"name": "task", "type": kind, **TASKS[kind]}
    if kind in PLACED:
        with pytest.raises(ValueError, match=ABSENT):
            built(scene, task)
    else:
        built(scene, task, REST)


@pytest.mark.parametrize("kind", ["workspace", "collision"])
def test_a_limit_that_is_not_registered_is_an_error(
    kind: str, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Watched, "add_barrier", lambda *_: None)
    with pytest.raises(ValueError, match=ABSENT):
        built(scene, REST, limits={kind: LIMITS[kind]})


@pytest.mark.parametrize("kind", ["workspace", "collision"])
def test_a_barrier_is_registered_where_a_command_leads_as_well(
    kind: str, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmrc.native.kinematics.of_barriers", lambda _: Watched())
    with pytest.raises(ValueError, match=ABSENT):
        built(scene, REST, limits={kind: LIMITS[kind]})


def test_methods_are_pythons() -> None:
    """What else there is to choose is Python's, and the native engine says so by name."""
    methods = get_args(rmrc.Config.model_fields["method"].annotation)
    line = REPOSITORY / "configs" / "panda_line.yaml"
    for method in set(methods) - {"qp"}:
        with pytest.raises(rmrc.RmrcError):
            rmrc.Controller(rmrc.compile(rmrc.load(line, overrides={"method": method})), "native")
