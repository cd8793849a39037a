"""Distances hold at every scale, wherever the joints are, whatever range they are given."""

from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from random_trees import FAR, case

import rmrc
from models import config
from rmrc.control.engines import Choice
from rmrc.model.distance import signed_distance

Array = NDArray[np.float64]

ENGINES: tuple[Choice, ...] = ("python", "native") if find_spec("rmrc._native") else ("python",)
PASSED = 1e-6
"""What a distance may be below `d_min`, m; of a robot shorter than 0.1 m 1e-5 of its length."""
JUDGED = 3e-6
"""What MuJoCo's distances of smooth geoms may differ by from one scale to another, at scale 1."""
DEEP = 0.02
"""Share of its depth by which MuJoCo knows the depth of an overlap."""
EXACT = 1e-12
"""Distance, as a multiple of the scale, to which analytic ones agree."""
SCALES = (1e-3, 1.0, 1e3)

# A hinge turns a slide that carries a sphere past a post at the distance D.
RAIL = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="yaw" type="hinge" axis="0 0 1"/><geom size="0.05" mass="1"/>
  <body><joint name="rail" type="slide" axis="1 0 0" {rail}/><geom name="tip" size="0.05"/></body>
</body><geom name="post" size="0.05" pos="0 {D} 0"/></worldbody></mujoco>"""
# A tool on a rail that goes through a wall, and a hinge whose sphere does not reach it.
TOOL = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="rail" type="slide" axis="1 0 0" {rail}/>
  <geom name="tool" type="box" size="{length} 0.1 0.1"/></body>
<geom name="wall" type="box" size="0.2 1 1"/>
<body pos="0 3 0"><joint name="hinge" type="hinge"/><geom name="other" size="0.1"/></body>
</worldbody></mujoco>"""
SHIP = """<mujoco><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom name="hull" size="10"/></body>
<geom name="rock" size="10" pos="1000 0 0"/></worldbody></mujoco>"""


def least(
    scene: str,
    folder: Path,
    engine: Choice,
    pair: tuple[str, str],
    goal: Array,
    steps: int,
    **others: object,
) -> float:
    """Return the least distance of two geoms on the way to a goal, by MuJoCo."""
    path = folder / "scene.xml"
    path.write_text(scene)
    task = {"name": "joints", "type": "posture", "gain": 5.0}
    problem = rmrc.compile(config(str(path), [task], **others))
    controller, data = rmrc.Controller(problem, engine), mujoco.MjData(problem.model)
    controller.set_target("joints", q=goal)
    geoms = sorted((problem.model.geom(name).id for name in pair), key=problem.model.geom_type.item)
    found, q = np.inf, problem.start
    for _ in range(steps):
        q = controller.step(q).q
        data.qpos[:] = q
        mujoco.mj_kinematics(problem.model, data)
        found = min(found, mujoco.mj_geomDistance(problem.model, data, *geoms, FAR, None))
    return found


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("rail", "position", "far", "dt", "acceleration"),
    [
        ('range="0 0.1"', {"rail": [0.0, 3.0]}, 3.0, 0.01, "off"),
        ('range="0 0.1"', {"rail": [0.0, 3.0]}, 3.0, 0.01, {"default": 2.0}),
        ('range="0 0.1"', "off", 3.0, 0.01, {"default": 2.0}),
        ("", {}, 20.0, 0.01, {"default": 2.0}),
    ],
    ids=["range", "range, acceleration", "off", "none"],
)
def test_a_slide_beyond_the_models_range_has_its_own_lever(
    rail: str, position: object, far: float, dt: float, acceleration: object, engine: Choice,
    tmp_path: Path,
) -> None:  # fmt: skip
    limits = {
        "position": position,
        "velocity": {"default": 2.0},
        "acceleration": acceleration,
        "collision": {"pairs": [["tip", "post"]], "d_min": 0.02, "detect": 0.05},
    }
    found = least(
        RAIL.format(rail=rail, D=far), tmp_path, engine, ("tip", "post"), np.array([np.pi, far]),
        int(3.0 / dt), dt=dt, start={"rail": far}, limits=limits,
    )  # fmt: skip
    assert 0.02 - PASSED <= found < 0.05


@pytest.mark.parametrize(
    ("rail", "position", "start", "length", "pairs"),
    [
        ("", {}, 5.0, 3.5, "all"),
        ("", {}, 5.0, 3.5, [["tool", "wall"]]),
        ('range="-0.1 0.1"', {"rail": [-0.1, 2.0]}, 1.0, 0.15, [["tool", "wall"]]),
        ('range="-1 1"', {}, 0.995, 0.74, [["tool", "wall"]]),
    ],
    ids=["all", "named", "configured", "at the end"],
)
def test_a_pair_apart_at_the_start_is_kept_apart(
    rail: str, position: object, start: float, length: float, pairs: object, tmp_path: Path
) -> None:
    limits = {
        "position": position,
        "velocity": {"default": 2.0},
        "collision": {"pairs": pairs, "d_min": 0.05, "detect": 0.1},
    }
    found = least(
        TOOL.format(rail=rail, length=length), tmp_path, ENGINES[-1], ("tool", "wall"),
        np.zeros(2), 1500, dt=0.004, start={"rail": start}, limits=limits,
    )  # fmt: skip
    assert 0.05 - PASSED <= found < 0.051


def compiled(rail: str, position: object, start: float, folder: Path) -> list[str]:
    """Return the notices of a robot whose tool is in the wall at its start."""
    path = folder / "scene.xml"
    path.write_text(TOOL.format(rail=rail, length=0.5))
    pairs = [["tool", "wall"], ["other", "wall"]]
    collision = {"pairs": pairs, "d_min": 0.05, "detect": 0.1}
    limits = {"position": position, "collision": collision}
    task = {"name": "joints", "type": "posture"}
    problem = rmrc.compile(config(str(path), [task], start={"rail": start}, limits=limits))
    return [notice for notice in problem.notices if "wherever" in notice]


def test_a_named_pair_is_left_out_where_the_config_keeps_it_together_and_is_named(
    tmp_path: Path,
) -> None:
    """From 0.75 m on tool and wall are apart: the model's range, the config's, one of 1 %, none."""
    (notice,) = compiled('range="-0.5 0.5"', {}, 0.0, tmp_path)
    assert "wall – tool" in notice
    (notice,) = compiled('range="-2 2"', {"rail": [-0.5, 0.5]}, 0.0, tmp_path)
    assert "wall – tool" in notice
    assert not compiled('range="-0.5 0.5"', {"rail": [-0.5, 2.0]}, 0.0, tmp_path)
    assert not compiled('range="-0.5 0.751"', {}, 0.0, tmp_path)
    assert not compiled("", {}, 0.0, tmp_path)
    assert not compiled('range="-0.5 0.5"', "off", 0.0, tmp_path)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("acceleration", ["off", {"default": 5.0}], ids=["free", "slow"])
@pytest.mark.parametrize(("d_min", "detect"), [(20.0, 60.0), (120.0, 150.0)])
def test_far_distances_hold(
    d_min: float, detect: float, acceleration: object, engine: Choice, tmp_path: Path
) -> None:
    limits = {
        "velocity": {"default": 20.0},
        "acceleration": acceleration,
        "collision": {"pairs": [["hull", "rock"]], "d_min": d_min, "detect": detect},
    }
    found = least(
        SHIP, tmp_path, engine, ("hull", "rock"), np.array([1000.0]), 700, dt=0.1, limits=limits
    )
    assert d_min - PASSED <= found < d_min + 0.1


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1.0, 1e3])
def test_a_capsule_and_a_box_are_measured_at_every_scale(scale: float) -> None:
    """MuJoCo's distance of the two is right at scale 1 where the axis does not pierce the box."""

    def model(by: float) -> mujoco.MjModel:
        capsule, box = by * np.array([0.1, 0.2]), by * np.array([0.1, 0.2, 0.15])
        sizes = [" ".join(f"{x:.17g}" for x in size) for size in (capsule, box)]
        return mujoco.MjModel.from_xml_string(
            f'<mujoco><worldbody><geom type="capsule" size="{sizes[0]}"/><body mocap="true">'
            f'<geom type="box" size="{sizes[1]}"/></body></worldbody></mujoco>'
        )

    rng, models, compared = np.random.default_rng(0), (model(scale), model(1.0)), 0
    datas, segment = [mujoco.MjData(m) for m in models], np.empty(6)
    for _ in range(300):
        place, turn = 0.4 * rng.normal(size=3), rng.normal(size=4)
        for m, data, by in zip(models, datas, (scale, 1.0), strict=True):
            data.mocap_pos[0], data.mocap_quat[0] = by * place, turn
            mujoco.mj_kinematics(m, data)
        ours = signed_distance(models[0], datas[0], (0, 1, True), FAR, segment) / scale
        assert np.linalg.norm(segment[3:] - segment[:3]) / scale == pytest.approx(abs(ours))
        if ours > -0.09:
            compared += 1
            theirs = mujoco.mj_geomDistance(models[1], datas[1], 0, 1, FAR, None)
            assert abs(ours - theirs) < EXACT
    assert compared > 200


def check(seed: int, scale: float, engine: Choice, steps: int, folder: Path) -> None:
    """Take steps through goals about the start, and hold every one to all distances."""
    robot, rng = case(seed, scale, folder), np.random.default_rng(seed)
    controller, data = rmrc.Controller(robot.problem, engine), mujoco.MjData(robot.unit)
    q, allowed = robot.problem.start, robot.problem.resolution / scale + JUDGED
    assert robot.problem.resolution <= min(PASSED, 1e-4 * scale)
    before = robot.distances(data, q)
    for k in range(steps):
        if k % 30 == 0:
            controller.set_target("joints", q=robot.goal(rng))
        step = controller.step(q)
        q, after = step.q, robot.distances(data, step.q)
        lost = np.minimum(robot.d_min, before) - after - DEEP * np.maximum(-before, 0.0)
        known = (before < FAR) & (before != 0.0)  # where MuJoCo has no distance of an overlap
        assert not known.any() or lost[known].max() <= allowed, (seed, scale, engine, k, step)
        before = after


@pytest.mark.parametrize("scale", SCALES)
def test_random_trees_keep_their_distances(scale: float, tmp_path: Path) -> None:
    for seed in range(8):
        check(seed, scale, ENGINES[-1], 90, tmp_path)
    check(8, scale, "python", 30, tmp_path)
