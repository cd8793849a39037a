"""Clearance: its slope, its rows, and the distance it keeps."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from nullspace_models import (
    CENTRAL_DIFFERENCE,
    ROUNDING,
    error_at,
    evaluation_of,
    signed_distance,
    slope,
    written,
)

import rmrc
from models import config, random_configuration, scene_path
from rmrc.problem.evaluation import Evaluation
from rmrc.tasks.clearance import ClearanceTerm

SHAPES = {
    "sphere": 'type="sphere" size=".1"',
    "capsule": 'type="capsule" size=".06 .15"',
    "box": 'type="box" size=".1 .07 .12"',
}

TWO_SHAPES = """
<mujoco>
  <worldbody>
    <geom name="still" {still} euler="17 -23 40"/>
    <body name="mover">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1"/>
      <joint axis=".2 1 .4" pos=".05 .1 0"/>
      <joint axis="1 .1 0" pos=".05 .1 -.02"/>
      <geom name="moving" {moving} euler="-29 12 6"/>
    </body>
  </worldbody>
</mujoco>
"""

FLOATING_BALL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="base" pos="0 0 2">
      <freejoint/>
      <geom name="ballast" type="sphere" size=".05"/>
      <body name="arm"><joint axis="0 1 0"/><geom name="bob" type="sphere" size=".1" pos="1 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


# Clearance.

DISTANCE = 0.1


def clearance_term(evaluation: Evaluation) -> ClearanceTerm:
    (term,) = evaluation.problem.terms
    assert isinstance(term, ClearanceTerm)
    return term


def row_error(distance: float, least: float) -> float:
    return 0.5 * max(0.0, least - distance) ** 2 / least


@pytest.mark.parametrize("gap", [0.08, 0.02, 1e-3, 1e-5, -1e-5, -1e-3, -0.05])
@pytest.mark.parametrize("moving", SHAPES)
@pytest.mark.parametrize("still", SHAPES)
def test_clearance_has_the_slope_of_its_error(
    still: str, moving: str, gap: float, tmp_path: Path
) -> None:
    scene = written(tmp_path, TWO_SHAPES.format(still=SHAPES[still], moving=SHAPES[moving]))
    task = {"type": "clearance", "pairs": [["still", "moving"]], "distance": DISTANCE}
    evaluation = evaluation_of(scene, task)

    def at(reach: float) -> np.ndarray:
        return np.array([0.6 * reach, 0.5 * reach, 0.62 * reach, 0.2, -0.3])

    def error(data: mujoco.MjData) -> float:
        return row_error(signed_distance(data, "still", "moving"), DISTANCE)

    inner, outer = 0.02, 1.0
    for _ in range(60):  # bisection for the gap
        middle = 0.5 * (inner + outer)
        evaluation.update(at(middle))
        wide = signed_distance(evaluation.data, "still", "moving") > gap
        inner, outer = (inner, middle) if wide else (middle, outer)
    q = at(outer)
    expected = -slope(evaluation, error, q)
    assert error_at(evaluation, q) == pytest.approx([row_error(gap, DISTANCE)], abs=1e-9)
    assert np.abs(evaluation.jacobian - expected).max() < CENTRAL_DIFFERENCE
    assert np.abs(expected).max() > 1e-2
    assert signed_distance(evaluation.data, "still", "moving") == pytest.approx(gap, abs=1e-9)


def test_clearance_has_a_row_for_each_pair_and_sees_every_pair_that_is_near() -> None:
    """The bounding spheres leave out no pair."""
    near, least = 0, 0.3
    scene = scene_path("dual_arm", Path())
    pairs = [["right_link5", "left_link5"], ["left_link6", "obstacles"], ["floor", "left_link4"]]
    task = {"type": "clearance", "pairs": pairs, "distance": least}
    evaluation = evaluation_of(scene, task)
    term, model = clearance_term(evaluation), evaluation.model
    for seed in range(20):
        rng = np.random.default_rng(seed)
        q = random_configuration(model, evaluation.problem.start, rng, 1.0)
        error = error_at(evaluation, q)
        expected = [
            row_error(mujoco.mj_geomDistance(model, evaluation.data, *pair, 10.0, None), least)
            for pair in term.geoms
        ]
        assert error == pytest.approx(expected, abs=ROUNDING)
        assert ((error > 0.0) == evaluation.jacobian.any(axis=1)).all()
        near += bool(error.any())
    assert 0 < near < 20


def test_a_capsule_that_pierces_a_box_is_pushed_out(tmp_path: Path) -> None:
    # Where the axis is inside the box, mj_geomDistance may call the two apart.
    shapes = {"still": 'type="box" size=".1 .1 .1"', "moving": 'type="capsule" size=".02 .15"'}
    scene = written(tmp_path, TWO_SHAPES.format(**shapes))
    task = {"type": "clearance", "pairs": [["still", "moving"]], "distance": DISTANCE}
    evaluation = evaluation_of(scene, task)
    error = error_at(evaluation, np.array([0.02, 0.01, 0.0, 0.0, 0.0]))
    assert error[0] > row_error(-0.05, DISTANCE)


def test_a_pair_goes_back_to_its_distance_at_the_gain(tmp_path: Path) -> None:
    gain, duration = 4.0, 0.5
    scene = written(tmp_path, TWO_SHAPES.format(still=SHAPES["sphere"], moving=SHAPES["sphere"]))
    task = {"name": "task", "type": "clearance", "pairs": [["still", "moving"]], "gain": gain}
    start, damping = [0.22, 0.02, 0.01, 0.0, 0.0], {"lambda": 1e-5}
    run = rmrc.solve(config(scene, [task], start=start, duration=duration, damping=damping))
    model = mujoco.MjModel.from_xml_path(scene)
    data, short = mujoco.MjData(model), []
    for q in (run.q[0], run.q[-1]):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        short.append(DISTANCE - signed_distance(data, "still", "moving"))
    # Euler steps of dt = 2 ms, as above; the damping takes less.
    assert short[1] == pytest.approx(np.exp(-0.5 * gain * duration) * short[0], rel=0.01)


def test_a_pair_that_is_far_leaves_all_motion_to_lower_levels() -> None:
    scene = scene_path("planar_3r", Path())
    posture = {"name": "posture", "type": "posture", "level": 1, "target": [0.2, 0.5, 0.6]}
    clear = {"name": "clear", "type": "clearance", "pairs": [["base", "link3"]], "distance": 0.1}
    start = {"start": [0.3, 0.3, 0.3], "priority": "strict"}
    with_it, without = (
        rmrc.Controller(rmrc.compile(config(scene, tasks, **start))).step().v
        for tasks in ([clear, posture], [posture])
    )
    assert np.abs(without).max() > 0.1
    assert with_it == pytest.approx(without, abs=ROUNDING)


def test_a_body_means_all_its_geoms_and_a_pair_counts_once() -> None:
    scene = scene_path("planar_3r", Path())
    by_body, by_geom = (
        evaluation_of(scene, {"type": "clearance", "pairs": pairs})
        for pairs in (
            [["base", "link3"], ["link3", "base"]],
            [["base", "pin3"], ["base", "link3"]],
        )
    )
    geoms = [clearance_term(e).geoms for e in (by_body, by_geom)]
    names = [{by_body.model.geom(i).name for i in np.ravel(pair)} for pair in geoms]
    assert names[0] == names[1] == {"base", "link3", "pin3"}
    assert [len(pair) for pair in geoms] == [2, 2]


def test_clearance_leaves_a_floating_base_alone_and_minds_planes_from_afar(tmp_path: Path) -> None:
    task = {"type": "clearance", "pairs": [["floor", "bob"]], "distance": 0.5}
    evaluation = evaluation_of(written(tmp_path, FLOATING_BALL), task)
    q = evaluation.problem.start.copy()
    q[:3] = (50.0, -30.0, 0.3)  # far from the plane's own centre; the bob is 0.2 above it
    error = error_at(evaluation, q)
    assert error == pytest.approx([row_error(0.2, 0.5)], abs=ROUNDING)
    slope = (1.0 - 0.2 / 0.5) * -1.0  # turning the arm lowers the bob
    assert evaluation.jacobian == pytest.approx(np.array([[0.0] * 6 + [slope]]), abs=ROUNDING)
    for height in (0.1, 0.7):  # touching, where there is no direction, and beyond the distance
        q[2] = height
        assert not error_at(evaluation, q).any()
        assert not evaluation.jacobian.any()
