"""The native engine beside the Python one where a step is more than a box: hard tasks, levels,
directions, the rows of limits, and terms that Python evaluates for it.
"""

from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest

import rmrc
from models import MENAGERIE, REPOSITORY, config

pytest.importorskip(
    "rmrc.native.engine", reason="the native extension is not built", exc_type=ImportError
)
from twins import assert_equal, twins

STEPS, MANY_STEPS = 200, 2000
START = [0.3, -0.4, 0.5, -1.8, 0.4, 1.7, 0.6]
"""Of the Panda, away from singularities: at its home v can be worth less than SAME."""

PANDA = str(REPOSITORY / "scenes" / "panda.xml")
BIPED = str(REPOSITORY / "scenes" / "biped.xml")
HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "hand"}}
POINT = {**HAND, "B": {"position": 1.0, "orientation": 0.0}}
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "B": 0.01}
BELOW = {**POSTURE, "level": 1}
COUPLED: dict[str, Any] = {
    "name": "pair",
    "type": "coupling",
    "coefficients": {"joint2": 1.0, "joint4": 0.5},
    "offset": 0.2,
}
ROUGH = {"velocity": {"default": 1.0}, "acceleration": {"default": 8.0}}
PLANES = [{"frame": {"site": "hand"}, "normal": [0, 0, 1], "offset": 0.3}]

TASKS: dict[str, list[dict[str, Any]]] = {
    "hard coupling": [HAND, POSTURE, COUPLED],
    "hard point": [{**POINT, "hard": True}, POSTURE],
    "hard frame, hard posture": [{**HAND, "hard": True}, {**POSTURE, "B": 1.0, "hard": True}],
    "hard gaze": [{"name": "gaze", "type": "look_at", "frame": {"site": "hand"}, "hard": True}],
    "hard axis": [
        POINT,
        {"name": "up", "type": "axis_align", "frame": {"body": "link6"}, "hard": True},
    ],
    "direction": [{**HAND, "preserve": "direction"}, POSTURE],
    "direction of a point": [{**POINT, "preserve": "direction"}, BELOW],
    "direction beside a hard coupling": [{**HAND, "preserve": "direction"}, POSTURE, COUPLED],
    "manipulability": [
        POINT,
        {"name": "agile", "type": "manipulability", "frame": {"site": "hand"}, "B": 0.1},
    ],
    "clearance": [
        POINT,
        {"name": "room", "type": "clearance", "pairs": [["gripper", "floor"]], "distance": 0.6},
    ],
}
OPTIONS: dict[str, dict[str, Any]] = {
    "soft": {},
    "strict": {"priority": "strict"},
    "acceleration": {"limits": ROUGH},
    "rows": {"limits": {**ROUGH, "workspace": PLANES, "speed": {"hand": {"linear": 0.3}}}},
    "some dofs": {"dofs": ["joint1", "joint2", "joint4", "joint5", "joint6"]},
    "undamped": {"priority": "strict", "damping": {"lambda": 0.0}},
    "adaptive": {"damping": {"lambda": 0.01, "adapt": "sigma_min", "threshold": 0.3}},
}


@pytest.mark.parametrize("tasks", TASKS)
@pytest.mark.parametrize("options", OPTIONS)
def test_every_task_with_every_option(tasks: str, options: str) -> None:
    chosen = TASKS[tasks]
    if options == "rows" and not any(task["name"] == "hand" for task in chosen):
        chosen = [*chosen, {**HAND, "B": 0.1}]
    problem = rmrc.compile(config(PANDA, chosen, start=START, dt=0.005, **OPTIONS[options]))
    assert_equal(problem, STEPS, moving=options in ("soft", "rows"))


@pytest.mark.parametrize("priority", ["soft", "strict"])
def test_three_levels(priority: str) -> None:
    left = {"name": "left", "type": "frame", "frame": {"site": "left_hand"}, "level": 1}
    tasks = [{"name": "com", "type": "com"}, left, {**POSTURE, "level": 2}]
    assert_equal(rmrc.compile(config(BIPED, tasks, priority=priority, limits=ROUGH)), STEPS)


@pytest.mark.parametrize("metric", ["inertia", 0.3])
def test_levels_within_a_metric(metric: Any) -> None:
    problem = rmrc.compile(config(PANDA, [POINT, BELOW], priority="strict", metric=metric))
    assert_equal(problem, STEPS)


def test_tasks_and_limits_of_minks() -> None:
    made = config(PANDA, [HAND])
    model = rmrc.compile(made).model
    posture = mink.PostureTask(model, cost=0.1, gain=0.02)
    posture.set_target(rmrc.compile(made).start + 0.3)
    slow = mink.VelocityLimit(model, {"joint1": 0.2})
    problem = rmrc.compile(made, mink_tasks=[posture], mink_limits=[slow])
    assert_equal(problem, STEPS, moving=True)


def test_ball_joints(tmp_path: Path) -> None:
    scene = tmp_path / "ball.xml"
    scene.write_text(
        """<mujoco><worldbody><body><joint type="ball" range="0 0.5"/>
        <geom size="0.05"/><body pos="0.3 0 0"><joint axis="0 0 1" range="-1 1" limited="true"/>
        <geom size="0.05"/><site name="hand" pos="0.3 0 0"/></body></body></worldbody></mujoco>"""
    )
    for tasks in ([HAND], [{**HAND, "preserve": "direction"}]):
        assert_equal(rmrc.compile(config(str(scene), tasks, limits=ROUGH)), STEPS)


def test_an_obstacle_that_comes_near() -> None:
    problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / "panda_obstacle.yaml"))
    pair = [rmrc.Controller(problem, engine=engine) for engine in ("python", "native")]
    name = next(iter(pair[0]._obstacle))
    start = problem.forward(problem.start)
    place = next(iter(start.values()))[:3, 3] + np.array([0.3, 0.0, 0.0])
    twist = np.array([-0.2, 0.0, 0.0, 0.0, 0.0, 0.5])
    for k in range(STEPS):
        leader, twin = pair
        twin._v[:] = leader._v
        q = leader.q
        for controller in pair:
            assert controller.set_obstacle(name, place + k * problem.dt * twist[:3], None, twist)
        python, native = leader.step(), twin.step(q)
        assert native.flags == python.flags
        np.testing.assert_allclose(native.v, python.v, rtol=0.0, atol=1e-8)


def test_timeouts_and_a_measured_velocity() -> None:
    options = {"previous": "measured", "timeout": {"target": 0.2}, "limits": ROUGH}
    problem = rmrc.compile(config(PANDA, [HAND, COUPLED], dt=0.01, **options))
    pair = [rmrc.Controller(problem, engine=engine) for engine in ("python", "native")]
    for controller in pair:
        assert controller.set_target("hand", problem.term["hand"].target[4:] + 0.1)
    stale = 0
    for _ in range(60):
        q, v = pair[0].q, 0.9 * pair[0]._v
        python, native = (controller.step(q, v=v) for controller in pair)
        assert native.flags == python.flags
        np.testing.assert_allclose(native.v, python.v, rtol=0.0, atol=1e-8)
        stale += rmrc.Status.STALE in python.flags
    assert 0 < stale < 60


def test_runs_with_rows_and_levels_are_the_same_bit_by_bit() -> None:
    for name in ("dual_arm_collision", "four_bar", "compare_redundant"):
        runs = []
        for _ in range(2):
            problem = rmrc.compile(rmrc.load(REPOSITORY / "configs" / f"{name}.yaml"))
            runs.append([native.v for _, native in twins(problem, STEPS, moving=True)])
        assert np.array_equal(*runs)


def test_an_explanation_is_the_same() -> None:
    limits = {**ROUGH, "workspace": PLANES}
    tasks = [HAND, COUPLED, {**POSTURE, "level": 1}]
    for options in ({}, {"priority": "strict"}):
        problem = rmrc.compile(config(PANDA, tasks, limits=limits, dt=0.005, **options))
        for python, native in twins(problem, 40):
            ours, theirs = native.explain(), python.explain()
            assert [(b.limit, b.name, b.side) for b in ours.bindings] == [
                (b.limit, b.name, b.side) for b in theirs.bindings
            ]
            assert ours.tasks == pytest.approx(theirs.tasks) or str(ours) == str(theirs)


VARIANTS: dict[str, dict[str, Any]] = {
    "hard": {"hard": True},
    "levels": {"priority": "strict"},
    "direction": {"preserve": "direction"},
    "collision": {"limits": {**ROUGH, "collision": {"pairs": "all", "detect": 0.05}}},
}


def real_robot(robot: str, variant: str) -> rmrc.Problem:
    scene, frame = MENAGERIE[robot]
    options = {"limits": ROUGH, **VARIANTS[variant]}
    hand = {**POINT, "frame": frame, "hard": options.pop("hard", False)}
    if preserve := options.pop("preserve", None):
        hand["preserve"] = preserve
    return rmrc.compile(config(f"menagerie:{scene}", [hand, BELOW], **options))


@pytest.mark.parametrize("robot", MENAGERIE)
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.usefixtures("menagerie")
def test_real_robots(robot: str, variant: str) -> None:
    assert_equal(real_robot(robot, variant), 100, moving=True)


@pytest.mark.slow
@pytest.mark.parametrize("robot", MENAGERIE)
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.usefixtures("menagerie")
def test_real_robots_over_long_runs(robot: str, variant: str) -> None:
    assert_equal(real_robot(robot, variant), MANY_STEPS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((REPOSITORY / "configs").glob("*.yaml")), ids=lambda p: p.stem
)
@pytest.mark.usefixtures("menagerie")
def test_shipped_configs_over_long_runs(path: Path) -> None:
    assert_equal(rmrc.compile(rmrc.load(path)), MANY_STEPS, moving=True)
