"""Hard tasks: the model's own constraints, couplings, and the equalities that all are made into."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from constrained_models import EXACT, compiled, equalities_of, panda

import rmrc
from models import config, random_configuration
from rmrc.problem.evaluation import Evaluation
from rmrc.qp.equalities import Equalities, weighed_directions
from rmrc.tasks.loop import LoopTerm

STEP = 1e-6
# Central differences err by STEP²·f''' ≈ 1e-12 and by rounding/STEP ≈ 1e-10 · the size of e.
CENTRAL_DIFFERENCE = 1e-8

# Every type of constraint that can be held, between sites and between bodies, on a floating base.
CONSTRAINED = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <compiler angle="radian"/>
  <worldbody>
    <site name="world" pos="0.3 0.1 0.2" euler="0.2 0.1 0"/>
    <body name="base" pos="0 0 0.5">
      <freejoint name="root"/>
      <geom size="0.05"/>
      <body name="upper" pos="0.1 0 0">
        <joint name="shoulder" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 0.05 0" size="0.01"/>
        <body name="lower" pos="0.2 0.05 0">
          <joint name="elbow" axis="0.3 1 0.2"/>
          <geom type="capsule" fromto="0 0 0 0.2 0 0.03" size="0.01"/>
          <site name="lower_end" pos="0.2 0 0.03" euler="0.3 0.2 0.1"/>
        </body>
      </body>
      <body name="carriage" pos="-0.1 0 0">
        <joint name="slide" type="slide" axis="1 0 0.2"/>
        <geom size="0.03"/>
        <body name="wrist" pos="0 0.1 0">
          <joint name="ball" type="ball"/>
          <geom size="0.02" pos="0.05 0 0"/>
          <site name="wrist_end" pos="0.05 0 0.02"/>
        </body>
      </body>
    </body>
    <body name="plate"><geom name="plate" size="0.01"/></body>
    <body name="fixture" pos="0.1 0.2 0.3"><geom size="0.01"/></body>
  </worldbody>
  <tendon>
    <fixed name="sum"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="0.5"/></fixed>
    <spatial name="string"><site site="world"/><site site="lower_end"/></spatial>
  </tendon>
  <equality>
    <connect name="pin" site1="lower_end" site2="wrist_end"/>
    <connect name="hook" body1="wrist" body2="lower" anchor="0.1 0.02 0.03"/>
    <weld name="clamp" site1="lower_end" site2="world" torquescale="0.7"/>
    <weld name="bond" body1="upper" body2="wrist" relpose="0.1 0 0.2 0.9 0.1 0.2 0.3"/>
    <joint name="gear" joint1="elbow" joint2="shoulder" polycoef="0.1 -0.5 0.3 0 0"/>
    <joint name="stop" joint1="slide" polycoef="0.05 0 0 0 0"/>
    <tendon name="belt" tendon1="sum" polycoef="0.2 0 0 0 0"/>
    <tendon name="rope" tendon1="string" tendon2="sum" polycoef="0.01 0.2 0 0 0"/>
    <weld name="spare" body1="upper" active="false"/>
    <connect name="idle" body1="plate" body2="fixture" anchor="0 0 0"/>
  </equality>
</mujoco>
"""
ROWS = {
    "pin": 3,
    "hook": 3,
    "clamp": 6,
    "bond": 6,
    "gear": 1,
    "stop": 1,
    "belt": 1,
    "rope": 1,
    "idle": 3,
}


def crank(rate: float = 1.0, **others: Any) -> dict[str, Any]:
    return {"name": "crank", "type": "velocity", "target": {"crank": rate}, **others}


def four_bar(*tasks: dict[str, Any], **others: Any) -> rmrc.Config:
    return config("scenes/four_bar.xml", list(tasks), **others)


@pytest.fixture(params=["dense", "sparse"])
def constrained(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    path = tmp_path / "constrained.xml"
    path.write_text(CONSTRAINED.format(jacobian=request.param))
    return str(path)


def error_at(evaluation: Evaluation, q: np.ndarray) -> np.ndarray:
    evaluation.update(q)
    evaluation.evaluate()
    return evaluation.error.copy()


@pytest.mark.parametrize("seed", range(3))
def test_loops_and_couplings_have_the_errors_derivatives(constrained: str, seed: int) -> None:
    tasks = [
        {"name": "all", "type": "loop"},
        {"name": "some", "type": "loop", "equalities": ["rope", "pin"]},
        {"name": "rack", "type": "coupling", "coefficients": {"slide": 1.0, "elbow": -0.3}},
        {"name": "pair", "type": "coupling", "coefficients": {"shoulder": 2.0}, "offset": 0.4},
    ]
    evaluation = Evaluation(rmrc.compile(config(constrained, tasks)))
    model, rng = evaluation.model, np.random.default_rng(seed)
    q = random_configuration(model, evaluation.problem.start, rng, 0.7)
    error_at(evaluation, q)
    analytic = evaluation.jacobian.copy()
    numeric = np.empty_like(analytic)
    for dof in range(model.nv):
        ends = []
        for sign in (1.0, -1.0):
            moved, direction = q.copy(), np.zeros(model.nv)
            direction[dof] = sign
            mujoco.mj_integratePos(model, moved, direction, STEP)
            ends.append(error_at(evaluation, moved))
        numeric[:, dof] = -(ends[0] - ends[1]) / (2 * STEP)
    np.testing.assert_allclose(analytic, numeric, atol=CENTRAL_DIFFERENCE)
    moves = np.any(analytic != 0.0, axis=1)
    idle = evaluation.rows_of([evaluation.problem.term["all"]]).stop - ROWS["idle"]
    np.testing.assert_array_equal(np.flatnonzero(~moves), idle + np.arange(ROWS["idle"]))


def test_a_loops_error_is_minus_the_gap(constrained: str) -> None:
    names = ["gear", "pin", "rope", "clamp"]
    tasks = [{"name": "loop", "type": "loop", "equalities": names}]
    evaluation = Evaluation(rmrc.compile(config(constrained, tasks, equalities="off")))
    model, data = evaluation.model, evaluation.data
    q = random_configuration(model, evaluation.problem.start, np.random.default_rng(0), 0.7)
    error = error_at(evaluation, q)
    elbow, shoulder = (data.joint(name).qpos[0] for name in ("elbow", "shoulder"))
    assert error[0] == pytest.approx(0.1 - 0.5 * shoulder + 0.3 * shoulder**2 - elbow, abs=EXACT)
    ends = [data.site(name).xpos for name in ("lower_end", "wrist_end", "world")]
    np.testing.assert_allclose(error[1:4], ends[1] - ends[0], atol=EXACT)
    length = np.linalg.norm(ends[2] - ends[0])
    slack = 0.01 + 0.2 * (shoulder + 0.5 * elbow)
    rest = model.tendon_length0[model.tendon("string").id]
    assert error[4] == pytest.approx(slack - (length - rest), abs=EXACT)
    np.testing.assert_allclose(error[5:8], ends[2] - ends[0], atol=EXACT)
    turns = [data.site(name).xmat.reshape(3, 3) for name in ("lower_end", "world")]
    angle = np.arccos(0.5 * (np.trace(turns[0].T @ turns[1]) - 1.0))
    assert np.linalg.norm(error[8:]) == pytest.approx(0.7 * np.sin(angle / 2), abs=EXACT)


def test_a_loop_reports_gaps_in_metres_and_angles_in_radians(constrained: str) -> None:
    tasks = [
        {"name": "all", "type": "loop", "equalities": list(ROWS)},
        {"name": "gaps", "type": "loop", "equalities": ["pin", "stop", "rope"]},
        {"name": "angles", "type": "loop", "equalities": ["gear", "belt"]},
        {"name": "weld", "type": "loop", "equalities": ["clamp"]},
    ]
    problem = rmrc.compile(config(constrained, tasks))
    units = {name: problem.term[name].units for name in ("all", "gaps", "angles", "weld")}
    assert units == {
        "all": ("m", "rad"),
        "gaps": ("m",),
        "angles": ("rad",),
        "weld": ("m", "rad"),
    }
    assert problem.term["all"].rows == sum(ROWS.values())
    # A rotation by θ is 0.7 sin(θ/2) in the weld's rows; 1e-3 rad is small.
    residual = np.array([3.0, 0.0, 4.0, 0.7 * np.sin(0.5e-3), 0.0, 0.0])
    np.testing.assert_allclose(problem.term["weld"].measure(residual), [5.0, 1e-3], rtol=1e-6)


def test_a_constraint_that_is_not_active_is_left_out_and_named_it_is_refused(
    constrained: str,
) -> None:
    loop = {"name": "loop", "type": "loop"}
    assert rmrc.compile(config(constrained, [loop])).term["loop"].rows == sum(ROWS.values())
    with pytest.raises(rmrc.ConfigError, match="'spare' is not active"):
        rmrc.compile(config(constrained, [{**loop, "equalities": ["spare"]}]))


def test_what_no_loop_names_is_held_by_default_and_noticed(constrained: str) -> None:
    names = [name for name in ROWS if name != "belt"]
    loop = {"name": "loop", "type": "loop", "equalities": names}
    problem = rmrc.compile(config(constrained, [loop]))
    held = problem.named("equalities")
    assert isinstance(held, LoopTerm)
    assert held.equalities == (problem.model.equality("belt").id,)
    assert not any("not held" in notice for notice in problem.notices)
    left_open = rmrc.compile(config(constrained, [loop], equalities="off"))
    assert "equality constraints of the model that are not held: 'belt'" in left_open.notices
    assert "equalities" not in left_open.term


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("", "no active equality constraint"),
        ("<option><flag equality='disable'/></option>", "disable"),
        ("<option><flag constraint='disable'/></option>", "disable"),
    ],
)
def test_a_loop_without_anything_to_hold_is_refused(
    tmp_path: Path, inside: str, message: str
) -> None:
    equality = "<equality><joint joint1='a'/></equality>" if inside else ""
    path = tmp_path / "bare.xml"
    path.write_text(
        f"<mujoco>{inside}<worldbody><body><joint name='a'/><geom size='0.1'/></body></worldbody>"
        f"{equality}</mujoco>"
    )
    with pytest.raises(rmrc.ConfigError, match=message):
        rmrc.compile(config(str(path), [{"name": "loop", "type": "loop"}]))


def test_a_constraint_of_a_flexible_body_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloth.xml"
    path.write_text(
        "<mujoco><worldbody><flexcomp name='cloth' type='grid' dim='2' count='3 3 1' "
        "spacing='.1 .1 .1' radius='.01'><edge equality='true'/></flexcomp></worldbody></mujoco>"
    )
    with pytest.raises(rmrc.ConfigError, match="flexible body"):
        rmrc.compile(config(str(path), [{"name": "loop", "type": "loop"}]))


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ({}, "at least one joint"),
        ({"shoulder": 0.0}, "not 0"),
        ({"ball": 1.0}, "no hinge or slide"),
        ({"root": 1.0}, "no hinge or slide"),
        ({"sholder": 1.0}, "did you mean 'shoulder'"),
    ],
)
def test_a_coupling_of_nothing_is_refused(
    constrained: str, coefficients: dict[str, float], message: str
) -> None:
    task = {"name": "coupling", "type": "coupling", "coefficients": coefficients}
    with pytest.raises(rmrc.ConfigError, match=message):
        rmrc.compile(config(constrained, [task]))


def test_a_weight_tells_directions() -> None:
    np.testing.assert_array_equal(
        weighed_directions(np.array([2.0, 0.0, 5.0])), [[1, 0, 0], [0, 0, 1]]
    )
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    rows = weighed_directions(7.0 * np.outer(normal, normal))
    assert rows.shape == (1, 3)
    np.testing.assert_allclose(np.abs(rows[0] @ normal), 1.0, atol=EXACT)
    assert weighed_directions(np.zeros(3)).shape == (0, 3)
    assert weighed_directions(np.zeros((3, 3))).shape == (0, 3)


def test_redundant_rows_are_removed(repository: Path) -> None:
    loop = {"name": "loop", "type": "loop"}
    again = {**loop, "name": "again", "gain": 50.0}
    once = equalities_of(compiled(four_bar(loop, crank()), repository))
    # The chain is planar: the third row of the pin is zero.
    assert once.matrix.shape == (2, 3)
    q = np.array([1.5, -0.9, 2.2])
    twice = equalities_of(compiled(four_bar(loop, {**loop, "name": "again"}), repository), q)
    once = equalities_of(compiled(four_bar(loop), repository), q)
    assert twice.matrix.shape == once.matrix.shape
    v = np.linalg.lstsq(once.matrix, once.right, rcond=None)[0]
    np.testing.assert_allclose(twice.matrix @ v, twice.right, atol=EXACT)
    assert twice.inconsistency < EXACT
    # The same rows with another gain ask for another speed.
    assert equalities_of(compiled(four_bar(loop, again), repository), q).inconsistency > 1e-3


def test_rows_that_contradict_one_another_meet_in_the_middle(repository: Path) -> None:
    tasks = [crank(1.0, hard=True), {**crank(2.0, hard=True), "name": "other"}]
    found = equalities_of(compiled(four_bar(*tasks, equalities="off"), repository))
    assert found.matrix.shape == (1, 3)
    np.testing.assert_allclose(found.right / found.matrix[0, 0], [1.5], atol=EXACT)
    assert found.inconsistency == pytest.approx(np.sqrt(0.5), abs=EXACT)


def test_what_no_joint_can_give_is_reported(repository: Path) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "hard": True}
    off = {"curvature": False}
    given = config("scenes/planar_2r.xml", [{**hand, "B": 1.0}], damping=off)
    problem = compiled(given, repository)
    found = equalities_of(problem, np.array([0.3, 0.0]))  # stretched: no motion along the arm
    assert found.matrix.shape == (2, 2)  # one of position, one of orientation
    assert found.inconsistency > 0.0


@pytest.mark.parametrize("kind", ["look_at", "axis_align"])
def test_an_axis_is_two_rows_and_consistent_at_any_error(repository: Path, kind: str) -> None:
    target = [0.3, 0.6, 0.2] if kind == "look_at" else [0.5, 0.5, -1.0]
    task = {"name": "axis", "type": kind, "frame": {"site": "hand"}, "target": target}
    problem = compiled(panda({**task, "hard": True}), repository)
    found = equalities_of(problem)
    assert found.matrix.shape == (2, 7)
    assert np.linalg.norm(found.right) > 1.0
    assert found.inconsistency < EXACT


def test_only_the_dofs_that_may_move_have_columns(repository: Path) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "hard": True}
    freeze = {"name": "still", "type": "freeze", "joints": ["joint2", "joint4"]}
    dofs = ["joint1", "joint2", "joint4", "joint6", "joint7"]
    found = equalities_of(compiled(panda(hand, freeze, dofs=dofs), repository))
    assert found.matrix.shape == (3, 5)
    np.testing.assert_array_equal(found.matrix[:, [1, 2]], 0.0)
    assert np.abs(found.matrix[:, [0, 3, 4]]).max() > 0.1


def test_a_number_that_is_not_finite_is_left_to_the_program(repository: Path) -> None:
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "hard": True}
    problem = compiled(panda(hand), repository)
    evaluation = Evaluation(problem)
    found = Equalities(problem, evaluation, evaluation.terms)
    evaluation.jacobian[:] = np.nan
    found.update(np.zeros(6), np.zeros(problem.dofs.size))
    assert np.isnan(found.matrix).any()
