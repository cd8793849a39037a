"""Where the robot stands does not matter: with its targets moved alike it moves the same."""

from dataclasses import replace
from pathlib import Path

import mink
import numpy as np
import pytest
from hypothesis import assume, given
from random_robots import (
    ROBOTS,
    Moment,
    Robot,
    assert_close,
    definite,
    each_robot,
    examples,
    numbers,
    random_moment,
    random_robot,
)

import rmrc
from models import random_quaternion

# Rounding of positions some meters away, times conditions up to 1e5.
SAME_MOTION = 1e-8

PLACED = """
<mujoco>
  <option integrator="implicitfast"/>
  <asset><model name="robot" file="{scene}"/></asset>
  <worldbody>
    <frame pos="{position}" quat="{quaternion}"><attach model="robot" prefix="placed_"/></frame>
  </worldbody>
</mujoco>
"""

METHODS = (
    "inverse",
    "transpose",
    "pinv",
    "weighted",
    "dls",
    "sdls",
    "nullspace",
    "saturated",
    "descent",
)
WAYS = {
    "qp": {},
    "strict": {"priority": "strict"},
    "limits": {"limits": {"velocity": {"default": 0.3}}},
    **{method: {"method": method} for method in METHODS},
}


def random_base(rng: np.random.Generator) -> mink.SE3:
    """Return a pose anywhere within some meters, turned in any way."""
    turn = mink.SO3(random_quaternion(rng))
    return mink.SE3.from_rotation_and_translation(turn, rng.normal(size=3))


def placed(robot: Robot, base: mink.SE3, folder: Path) -> Robot:
    """Return the same robot in a scene where all of it has moved by `base`."""
    position, quaternion = base.translation(), base.rotation().wxyz
    path = folder / f"placed_{position[0]:.17g}_{Path(robot.scene).stem}.xml"
    path.write_text(
        PLACED.format(
            scene=robot.scene,
            position=" ".join(f"{value:.17g}" for value in position),
            quaternion=" ".join(f"{value:.17g}" for value in quaternion),
        )
    )
    root = {kind: f"placed_{name}" for kind, name in robot.root.items()}
    return replace(robot, scene=str(path), site=f"placed_{robot.site}", root=root)


def floats(controller: rmrc.Controller) -> bool:
    """Return whether the robot's base is not fixed but part of q."""
    return controller.problem.model.nq > controller.problem.model.nv


def moved(moment: Moment, base: mink.SE3, floating: bool) -> Moment:
    """Return the same moment of the robot that has moved by `base`."""
    q, rotation = moment.q.copy(), base.rotation()
    if floating:
        pelvis = base @ mink.SE3(np.append(q[3:7], q[:3]))
        q[:3], q[3:7] = pelvis.translation(), pelvis.rotation().wxyz
    assert moment.velocity is not None
    twist = np.append(rotation.apply(moment.velocity[:3]), rotation.apply(moment.velocity[3:]))
    return Moment(q, base @ moment.target, twist)


def turned(v: np.ndarray, base: mink.SE3, floating: bool) -> np.ndarray:
    """Return the same joint velocity of the moved robot: a base has its velocity in the world."""
    return np.append(base.rotation().apply(v[:3]), v[3:]) if floating else v


@pytest.mark.parametrize(
    ("robot", "way"),
    [
        (robot, way)
        for robot in ROBOTS
        for way in WAYS
        if way != "inverse" or robot in ("planar", "ur5e")
    ],
)
@examples(3)
@given(numbers)
def test_every_method_moves_the_same_elsewhere(robot, way, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    folder = tmp_path_factory.getbasetemp()
    here, base = random_robot(robot, rng, folder), random_base(rng)
    assume(way != "inverse" or len(here.rows) == here.joints)
    there = placed(here, base, folder)
    weight = definite(rng, len(here.rows))
    metric = rng.uniform(0.1, 1.0, here.controller(here.hand()).problem.model.nv)
    metric[:3] = metric[0]  # the same in all directions, for a base that moves in them
    options = {"metric": metric.tolist(), "damping": {"lambda": 0.1}, **WAYS[way]}
    one, other = (arm.controller(arm.hand(weight), **options) for arm in (here, there))
    moment, floating = random_moment(one, rng), floats(one)
    v = moment.step(one).v
    assert np.abs(v).max() > SAME_MOTION
    elsewhere = moved(moment, base, floating).step(other).v
    assert_close(elsewhere, turned(v, base, floating), SAME_MOTION)


@each_robot
@pytest.mark.parametrize("priority", ["soft", "strict"])
@examples(3)
@given(numbers)
def test_every_task_asks_for_the_same_elsewhere(robot, priority, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    folder = tmp_path_factory.getbasetemp()
    here, base = random_robot(robot, rng, folder), random_base(rng)
    there = placed(here, base, folder)
    bare = here.controller(here.hand())
    home, moment, floating = random_moment(bare, rng), random_moment(bare, rng), floats(bare)
    weight, block = definite(rng, 6), np.kron(np.eye(2), base.rotation().as_matrix())
    point, direction, twist = rng.normal(size=(3, 3))
    quaternion = random_quaternion(rng)
    rates = []
    for arm, pose, world in (
        (here, mink.SE3.identity(), weight),
        (there, base, block @ weight @ block.T),
    ):
        frame = {"frame": {"site": arm.site}}
        controller = arm.controller(
            arm.hand(),
            {"name": "world", "type": "frame", **frame, "axes": "world", "B": world.tolist()},
            {"name": "relative", "type": "relative_frame", **frame, "root": arm.root},
            {"name": "com", "type": "com", "level": 1},
            {"name": "look", "type": "look_at", **frame, "level": 1},
            {"name": "align", "type": "axis_align", **frame, "level": 1},
            {"name": "posture", "type": "posture", "level": 2},
            start=moved(home, pose, floating).q.tolist(),
            damping={"lambda": 0.1},
            priority=priority,
        )
        turn = pose.rotation().apply
        target = pose @ mink.SE3(np.append(quaternion, point))
        assert controller.set_target("world", target.translation(), target.rotation().wxyz)
        for name in ("com", "look"):
            assert controller.set_target(name, pose.apply(point), velocity=turn(twist))
        assert controller.set_target("align", direction=turn(direction), velocity=turn(twist))
        rates.append(moved(moment, pose, floating).step(controller).v)
    assert_close(rates[1], turned(rates[0], base, floating), SAME_MOTION)
