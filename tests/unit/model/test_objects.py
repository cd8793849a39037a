"""Objects: what nobody drives or claims is where q says, in the way, and does not move."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes_with_objects import ARM, BENT, CUP, DOOR, DRIVEN, GRASP, HAND, MOTORS, POSTURE, scene

import rmrc
from models import config
from rmrc.runs.check import check

Array = NDArray[np.float64]

# MuJoCo's distances are no finer, and a step may end this much below d_min.
MEASURED = 1e-6
# v of the two engines, relative to its largest element, as docs/native.md promises.
ENGINES = 1e-8
REACHED = 1e-3
"""m: a task with this error is where it should be."""


@pytest.fixture
def made(tmp_path: Path) -> Any:
    """What makes a configuration of a scene's text."""

    def make(text: str, tasks: list[dict[str, Any]], **others: Any) -> rmrc.Config:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.xml"
        path.write_text(text)
        return config(str(path), tasks, **{"dt": 0.005} | others)

    return make


def names(problem: rmrc.Problem) -> list[str]:
    return [problem.objects.name(root) for root in problem.objects.roots]


CUP_FRAME = {"name": "cup", "type": "frame", "frame": {"body": "cup"}}
ALL = scene(ARM, CUP, DOOR)
LOOP = {"name": "loop", "type": "loop"}
EQUALITIES = '<equality><connect name="pin" body1="cup" body2="fore" anchor="0 0 0"/></equality>'
CHAINED = EQUALITIES.replace("fore", "latch").replace(
    "</equality>", '<joint joint1="door_hinge" joint2="j1"/></equality>'
)
TENDON = """<tendon><fixed name="pull"><joint joint="latch_slide" coef="1"/></fixed></tendon>
<actuator><motor joint="j1"/><motor tendon="pull"/></actuator>"""
ROPE = """<tendon><spatial name="rope"><site site="tcp"/><site site="rim"/></spatial></tendon>
<actuator><motor tendon="rope"/></actuator>"""
RIMMED = CUP.replace("</body>", '<site name="rim"/></body>')


@pytest.mark.parametrize(
    ("text", "tasks", "dofs", "found"),
    [
        (DRIVEN, [HAND], None, ["cup", "door"]),
        (DRIVEN, [POSTURE], None, ["cup", "door"]),
        (ALL, [HAND], None, ["cup", "door"]),
        (ALL, [GRASP], None, ["cup", "door"]),
        (ALL, [POSTURE], None, ["cup"]),  # nothing would move: free bodies alone are objects
        (scene(CUP), [POSTURE], None, []),  # and then still nothing would
        (scene(CUP, CUP.replace("cup", "mug")), [CUP_FRAME], None, ["mug"]),
        (DRIVEN, [HAND, CUP_FRAME], None, ["door"]),
        (DRIVEN, [HAND, {**GRASP, "frame": {"geom": "cup_geom"}, "root": {"site": "tcp"}}], None,
         ["door"]),
        (DRIVEN, [HAND, {"name": "com", "type": "com", "body": "latch"}], None, ["cup"]),
        (DRIVEN, [HAND, {"name": "com", "type": "com"}], None, ["cup", "door"]),
        (DRIVEN, [HAND, {"name": "v", "type": "velocity", "target": {"door_hinge": 0.1}}], None,
         ["cup"]),
        (DRIVEN, [HAND, {**POSTURE, "target": {"latch_slide": 0.1}}], None, ["cup"]),
        (DRIVEN, [HAND, {"name": "still", "type": "freeze", "joints": ["cup_free"]}], None,
         ["door"]),
        (DRIVEN, [HAND, {"name": "mid", "type": "centering", "joints": ["door_hinge"]}], None,
         ["cup"]),
        (DRIVEN, [HAND, {"name": "mid", "type": "centering"}], None, ["cup", "door"]),
        (DRIVEN, [HAND, {"name": "c", "type": "coupling",
                         "coefficients": {"j1": 1, "door_hinge": 1}}], None, ["cup"]),
        (DRIVEN, [{"name": "look", "type": "look_at", "frame": {"body": "cup"}}], None, ["door"]),
        (DRIVEN, [HAND], ["j1", "door_hinge"], ["cup"]),
        (DRIVEN, [HAND], ["j1", "cup_free"], ["door"]),
        (scene(ARM, CUP, actuators=EQUALITIES + MOTORS), [{"name": "l", "type": "loop"}], None, []),
        (scene(ARM, CUP, DOOR, actuators=TENDON), [HAND], None, ["cup"]),
        # What the model itself ties to the robot moves with it, as if a loop named it.
        (scene(ARM, CUP, actuators=EQUALITIES + MOTORS), [HAND], None, []),
        (scene(ARM, CUP, actuators=EQUALITIES + MOTORS), [HAND, LOOP], None, []),
        (scene(ARM, CUP, DOOR, actuators=EQUALITIES.replace("fore", "latch") + MOTORS), [HAND],
         None, ["cup", "door"]),
        (scene(ARM, CUP, actuators=EQUALITIES.replace("fore", "world") + MOTORS), [HAND], None,
         ["cup"]),
        (scene(ARM, CUP, DOOR, actuators=CHAINED + MOTORS), [HAND, LOOP], None, []),
        (scene(ARM, RIMMED, DOOR, actuators=ROPE), [HAND], None, ["door"]),
        (scene(ARM, RIMMED, actuators='<actuator><general site="rim"/></actuator>'), [HAND], None,
         []),
    ],
)  # fmt: skip
def test_objects_are_the_trees_that_nobody_drives_or_claims(
    made: Any, text: str, tasks: list[dict[str, Any]], dofs: list[str] | None, found: list[str]
) -> None:
    problem = rmrc.compile(made(text, tasks, dofs=dofs))
    assert names(problem) == found
    model, moved = problem.model, set(problem.dofs.tolist())
    for dof, body in enumerate(model.dof_bodyid):
        if model.body(int(model.body_rootid[body])).name in found:
            assert dof not in moved
        elif dofs is None:
            assert dof in moved
    assert any(all(name in line for name in found) for line in problem.notices) or not found


def test_a_task_of_minks_claims_its_frame(made: Any) -> None:
    own = mink.FrameTask("cup", "body", 1.0, 1.0)
    own.set_target(mink.SE3.identity())
    assert names(rmrc.compile(made(DRIVEN, [HAND]), mink_tasks=[own])) == ["door"]


def test_a_floating_robot_without_actuators_stays_the_robot(made: Any) -> None:
    floating = ARM.replace('<joint name="j1" axis="0 0 1" range="-3 3" limited="true"/>',
                           "<freejoint/>")  # fmt: skip
    problem = rmrc.compile(made(scene(floating, CUP), [HAND]))
    assert names(problem) == ["cup"]
    assert problem.dofs.size == 7


def test_check_names_objects_and_no_limit_of_theirs(made: Any) -> None:
    lines = "\n".join(check(made(DRIVEN, [HAND])))
    assert "cup, door" in lines
    assert "2 of 10 dofs move" in lines
    for name in ("door_hinge", "latch_slide", "cup_free", "floating base"):
        assert name not in lines


def test_a_door_outside_its_range_is_no_violation(made: Any) -> None:
    start = {**BENT, "door_hinge": -0.5}
    run = rmrc.solve(made(DRIVEN, [HAND], start=start, duration=0.1,
                          limits={"position": {"margin": 0.6}}))  # fmt: skip
    assert run.summary["limits"]["position"]["max_violation"] == 0.0
    assert "RECOVERING" not in run.summary["status"]
    assert not any("outside the position" in line for line in check(made(DRIVEN, [HAND])))


SWEEP = {"hand": {"path": "line", "to": {"position": [0.3, 0.6, 0.3]}, "duration": 1.0}}
PAIRS: list[Any] = ["all", [["hand_geom", "cup_geom"], ["fore", "door"]]]


@pytest.mark.parametrize("engine", ["python", "native"])
@pytest.mark.parametrize("pairs", PAIRS, ids=["all", "named"])
@pytest.mark.parametrize("acceleration", ["off", {"default": 10.0}])
def test_the_arm_stops_before_the_cup(
    made: Any, engine: str, pairs: Any, acceleration: Any
) -> None:
    limits = {"collision": {"pairs": pairs, "d_min": 0.02, "detect": 0.1},
              "acceleration": acceleration}  # fmt: skip
    run = rmrc.solve(made(DRIVEN, [HAND], duration=2.0, limits=limits, targets=SWEEP,
                          engine=engine))  # fmt: skip
    model = rmrc.compile(made(DRIVEN, [HAND])).model
    np.testing.assert_array_equal(run.q[:, 2:], np.tile(run.q[0, 2:], (len(run.q), 1)))
    assert least_distance(model, run.q, "hand_geom", "cup_geom") >= 0.02 - MEASURED
    assert run.summary["limits"]["collision"]["max_violation"] == 0.0
    assert np.ptp(run.q[:, :2]) > 0.2


def least_distance(model: mujoco.MjModel, path: Iterable[Array], one: str, other: str) -> float:
    data, least = mujoco.MjData(model), np.inf
    for q in path:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        ids = model.geom(one).id, model.geom(other).id
        least = min(least, mujoco.mj_geomDistance(model, data, *ids, 1.0, None))
    return least


@pytest.mark.parametrize("engine", ["python", "native"])
def test_the_cup_is_where_it_is_measured(made: Any, engine: Any) -> None:
    """A hand pushes the cup about, 2 cm a step at most: the arm keeps its distance or goes back."""
    limits = {"collision": {"pairs": "all", "d_min": 0.02, "detect": 0.1}, "velocity": "off"}
    problem = rmrc.compile(made(DRIVEN, [HAND, POSTURE], start=BENT, limits=limits))
    controller, q = rmrc.Controller(problem, engine=engine), problem.start.copy()
    rng, place, least = np.random.default_rng(0), q[2:5].copy(), np.inf
    controller.set_target("hand", position=[0.3, 0.6, 0.3])
    for k in range(200):
        if k == 100:  # the cup is put elsewhere at once, in the way of the next motion
            place[:2] = 0.55, 0.1
            controller.set_target("hand", position=[0.5, -0.3, 0.3])
        before = q.copy()
        q[2:5] = place + rng.uniform(-1e-3, 1e-3, 3) * [1, 1, 0]
        if least_distance(problem.model, [q], "hand_geom", "cup_geom") < 0.02:
            q = before
        step = controller.step(q)
        assert np.isfinite(step.v).all()
        assert not step.v[2:].any()
        np.testing.assert_array_equal(step.q[2:], q[2:])
        q[:2] = step.q[:2]
        least = min(least, least_distance(problem.model, [q], "hand_geom", "cup_geom"))
    assert least >= 0.02 - MEASURED
    assert least < 0.05  # the cup was in the way


def test_engines_agree_beside_objects(made: Any) -> None:
    limits = {"collision": {"pairs": "all", "d_min": 0.02, "detect": 0.2}}
    tasks = [
        {**GRASP, "B": {"position": 1.0, "orientation": 0.1}},
        {"name": "com", "type": "com", "level": 1},
        {"name": "smooth", "type": "smooth", "B": coupled(10), "level": 1},
        {"name": "energy", "type": "kinetic_energy", "B": 1e-3},
        {**POSTURE, "B": coupled(10)},
    ]
    text = scene(ARM, CUP, DOOR.replace("-.6 0 .3", "-.6 .1 .3"), actuators=MOTORS)
    problem = rmrc.compile(made(text, tasks, start=BENT, limits=limits, metric=coupled(10)))
    leader, twin = (rmrc.Controller(problem, engine=engine) for engine in ("python", "native"))
    rng, q = np.random.default_rng(0), problem.start.copy()
    for _ in range(150):
        mujoco.mj_integratePos(problem.model, q, rng.normal(size=10) * [0, 0, *[0.02] * 8], 1.0)
        python, native = leader.step(q), twin.step(q)
        assert python.flags == native.flags
        scale = max(1.0, float(np.abs(python.v).max()))
        assert np.abs(python.v - native.v).max() < ENGINES * scale
        assert not python.v[2:].any()
        q[:2] = python.q[:2]


def coupled(size: int) -> list[list[float]]:
    """Return a weight that couples all dofs with one another."""
    root = np.random.default_rng(3).normal(size=(size, size)) * 0.1
    return (root @ root.T).tolist()


@pytest.mark.parametrize("engine", ["python", "native"])
def test_the_hand_goes_to_the_cup(made: Any, engine: Any) -> None:
    controller = rmrc.Controller(
        problem := rmrc.compile(made(DRIVEN, [GRASP], start=BENT)), engine=engine
    )
    q, data = problem.start.copy(), mujoco.MjData(problem.model)
    controller.set_target("grasp", position=[0.0, 0.0, 0.05])
    q[4] = 0.25  # so that the hand's plane has the target
    for k in range(400):
        q[2] += 2e-4 if k < 200 else 0.0  # the cup is pushed on
        q[:2] = controller.step(q).q[:2]
    data.qpos[:] = q
    mujoco.mj_kinematics(problem.model, data)
    assert np.linalg.norm(data.site("tcp").xpos - q[2:5] - [0, 0, 0.05]) < REACHED
    assert controller.step(q).error["grasp"][0] < REACHED


@pytest.mark.parametrize("body", [None, "world"])
def test_com_is_the_robots_alone(made: Any, body: str | None) -> None:
    tasks = [{"name": "com", "type": "com", "body": body}]
    path = {"com": {"path": "line", "coordinates": "start", "to": {"position": [0.03, 0.05, 0]},
                    "duration": 0.5}}  # fmt: skip
    run = rmrc.solve(made(DRIVEN, tasks, start=BENT, targets=path, duration=1.0))
    model = rmrc.compile(made(DRIVEN, tasks)).model
    data, root = mujoco.MjData(model), model.body("base").id
    centres = []
    for q in (run.q[0], run.q[-1]):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centres.append(data.subtree_com[root].copy())
    assert np.abs(centres[1] - centres[0] - [0.03, 0.05, 0]).max() < REACHED
    np.testing.assert_array_equal(run.q[-1, 2:], run.q[0, 2:])


@pytest.mark.parametrize("engine", ["python", "native"])
def test_how_an_object_moves_is_no_velocity_of_the_robots(made: Any, engine: Any) -> None:
    tasks = [HAND, {"name": "smooth", "type": "smooth", "B": coupled(10)}]
    problem = rmrc.compile(made(DRIVEN, tasks, start=BENT, previous="measured",
                                limits={"acceleration": {"default": 5.0}}))  # fmt: skip
    still, pushed = (rmrc.Controller(problem, engine=engine) for _ in range(2))
    q, other = problem.start.copy(), problem.start.copy()
    rng = np.random.default_rng(0)
    for controller in (still, pushed):
        controller.set_target("hand", position=[0.2, 0.4, 0.3])
    for k in range(50):
        measured = rng.normal(size=10) if k % 3 == 0 else None
        given = None if measured is None else measured * ([1.0] * 2 + [0.0] * 8)
        one, two = still.step(q, v=given), pushed.step(other, v=measured)
        np.testing.assert_array_equal(one.v, two.v)
        q = one.q.copy()
        mujoco.mj_integratePos(problem.model, other, rng.normal(size=10) * 0.1, 1.0)
        other[:2] = q[:2]
