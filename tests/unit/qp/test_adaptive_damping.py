"""λ that adapts: its formulas, the rows that it looks at, and its place in the program."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config, random_configuration
from rmrc import reference

Array = NDArray[np.float64]

# Two ways to the same singular values, whose squares enter.
ROUNDING = 1e-9
# Backends are asked for 1e-12 in a program whose weights are at most 1, of condition up to 1e4.
SAME_OPTIMUM = 1e-7
OFF = {"position": "off", "velocity": "off"}
FLOOR, LARGEST = 0.02, 0.3

ROBOTS = {"panda": "hand", "ur5e": "tool", "planar_3r": "hand"}
WEIGHTS = {
    "panda": [1.0, 2.0, 3.0, 0.5, 0.6, 0.7],
    "ur5e": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
    "planar_3r": [1.0, 4.0, 0.0, 0.0, 0.0, 0.5],
}
each_robot = pytest.mark.parametrize("robot", ROBOTS)
each_way = pytest.mark.parametrize("adapt", ["sigma_min", "manipulability", "error"])


def controller(robot: str, *tasks: dict[str, Any], **others: Any) -> rmrc.Controller:
    """Return a controller without limits and curvature, unless the options say so."""
    scene = str(REPOSITORY / "scenes" / f"{robot}.xml")
    damping = {"curvature": "off", **others.pop("damping", {})}
    options = {"limits": OFF, "damping": damping, **others}
    return rmrc.Controller(rmrc.compile(config(scene, list(tasks), **options)))


def hand(robot: str, **others: Any) -> dict[str, Any]:
    frame = {"site": ROBOTS.get(robot, "hand")}
    return {"name": "hand", "type": "frame", "frame": frame, "B": WEIGHTS.get(robot, 1.0), **others}


def adapting(adapt: str, **others: float) -> dict[str, Any]:
    return {"lambda": FLOOR, "adapt": adapt, "largest": LARGEST, **others}


def weighted_rows(made: rmrc.Controller, name: str = "hand") -> tuple[Array, Array]:
    """Return √B J and √B e of a task of diagonal weight at the last step, without idle rows."""
    evaluation, term = made.engine.evaluation, made.problem.term[name]
    rows, weighed = evaluation.rows_of([term]), term.weight > 0.0
    root = np.sqrt(term.weight[weighed])
    jacobian = evaluation.jacobian[rows][weighed][:, made.problem.dofs]
    return root[:, None] * jacobian, root * evaluation.error[rows][weighed]


@each_robot
@each_way
def test_the_damping_is_the_formula_of_the_reference(robot: str, adapt: str) -> None:
    bare = controller(robot, hand(robot))
    rng, start = np.random.default_rng(0), bare.problem.start
    moments = [random_configuration(bare.problem.model, start, rng, 1.0) for _ in range(20)]
    targets = [
        bare.problem.term["hand"].target[4:] + rng.uniform(0.0, 0.4) * rng.normal(size=3)
        for _ in moments
    ]
    rows = []
    for q in moments:
        bare.step(q)
        rows.append(weighted_rows(bare)[0])
    sigma = np.array([np.linalg.svd(W, compute_uv=False) for W in rows])
    measure = sigma[:, -1] if adapt == "sigma_min" else sigma.prod(axis=1)
    threshold = float(np.median(measure))  # so that λ is above its floor at every second moment
    made = controller(robot, hand(robot), damping=adapting(adapt, threshold=threshold))
    raised = []
    for q, target in zip(moments, targets, strict=True):
        made.set_target("hand", target)
        made.step(q)
        W, e = weighted_rows(made)
        if adapt == "sigma_min":
            added = reference.damping_sigma_min(W, LARGEST, threshold)
        elif adapt == "manipulability":
            added = reference.damping_manipulability(W, LARGEST, threshold)
        else:
            added = min(reference.damping_error(e, 0.0), LARGEST)
        assembly = made.engine.assembly
        assert assembly.damping == pytest.approx(np.hypot(FLOOR, added), rel=ROUNDING)
        assert assembly.damped == (added > 1e-3 * FLOOR)
        raised.append(assembly.damped)
    if adapt == "error":
        assert all(raised)
    else:
        assert 5 <= sum(raised) <= 15


@each_robot
@each_way
def test_the_program_has_the_damping_that_is_shown(robot: str, adapt: str) -> None:
    made = controller(robot, hand(robot), damping=adapting(adapt, threshold=100.0))
    made.set_target("hand", made.problem.term["hand"].target[4:] + 0.1)
    step = made.step()
    W, e = weighted_rows(made)
    damping = made.engine.assembly.damping
    assert damping > 1.1 * FLOOR
    expected = np.linalg.solve(W.T @ W + damping**2 * np.eye(step.v.size), W.T @ (10.0 * e))
    assert step.v == pytest.approx(expected, abs=SAME_OPTIMUM * np.abs(expected).max())


@pytest.mark.parametrize("priority", ["soft", "strict"])
def test_the_levels_of_a_cascade_have_it_too(priority: str) -> None:
    damping = adapting("sigma_min", threshold=100.0)
    made = controller("panda", hand("panda"), damping=damping, priority=priority)
    made.set_target("hand", made.problem.term["hand"].target[4:] + 0.1)
    v = made.step().v
    W, e = weighted_rows(made)
    square = made.engine.assembly.damping**2
    expected = np.linalg.solve(W.T @ W + square * np.eye(7), W.T @ (10.0 * e))
    assert v == pytest.approx(expected, abs=SAME_OPTIMUM * np.abs(expected).max())


def test_off_is_the_floor_and_nothing_is_damped() -> None:
    made = controller("planar_3r", hand("planar_3r"), damping={"lambda": FLOOR})
    made.set_target("hand", [50.0, 0.0, 0.0])
    made.step(np.zeros(3))
    assert made.engine.assembly.damping == pytest.approx(FLOOR)
    assert not made.engine.assembly.damped


@each_way
def test_without_tasked_rows_it_stays_at_its_floor(adapt: str) -> None:
    posture = {"name": "posture", "type": "posture"}
    idle = hand("panda", B=0.0)
    made = controller("panda", posture, idle, damping=adapting(adapt, threshold=100.0))
    made.set_target("hand", [1.0, 1.0, 1.0])
    made.step()
    assert made.engine.assembly.damping == pytest.approx(FLOOR)
    assert np.isnan(made.engine.assembly.sigma_min())


def test_lower_levels_and_joints_that_stand_still_have_no_part_in_it() -> None:
    low = {"name": "low", "type": "frame", "frame": {"body": "link4"}, "level": 1, "B": 1e-6}
    posture = {"name": "posture", "type": "posture", "level": 2, "B": 1e-9}
    dofs = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6"]
    alone = controller("panda", hand("panda"), dofs=dofs)
    among = controller("panda", low, hand("panda"), posture, dofs=dofs)
    whole = controller("panda", hand("panda"))
    for made in (alone, among, whole):
        made.step()
    found, others = alone.engine.assembly.sigma_min(), among.engine.assembly.sigma_min()
    least = np.linalg.svd(weighted_rows(alone)[0], compute_uv=False)[-1]
    assert found == pytest.approx(least, rel=ROUNDING)
    assert others == pytest.approx(found, rel=ROUNDING)
    assert whole.engine.assembly.sigma_min() > found


def test_the_weight_of_a_soft_level_has_no_part_in_it() -> None:
    high, low = (controller("panda", hand("panda", level=level)) for level in (0, 2))
    high.step()
    low.step()
    found = low.engine.assembly.sigma_min()
    assert found == pytest.approx(high.engine.assembly.sigma_min(), rel=ROUNDING)


PLANE_ALONE = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("robot", "task", "served"),
    [
        # z of a planar arm, and in a full pose two of its rotations too.
        ("planar_4r", {"B": {"orientation": 0.0}}, {"B": PLANE_ALONE}),
        ("planar_2r", {"B": {"orientation": 0.0}}, {"B": PLANE_ALONE}),
        ("planar_4r", {"B": 1.0}, {"B": [1.0, 1.0, 0.0, 0.0, 0.0, 1.0]}),
        # B of rank 2, full in x and y, whose root has rows of rounding.
        (
            "planar_4r",
            {"B": np.pad([[2.0, 1.0], [1.0, 2.0]], (0, 4)).tolist()},
            {"B": np.pad([[2.0, 1.0], [1.0, 2.0]], (0, 4), constant_values=0.0).tolist()},
        ),
    ],
)
def test_rows_that_no_motion_can_serve_are_not_singular(
    robot: str, task: dict[str, Any], served: dict[str, Any]
) -> None:
    made = controller(robot, hand(robot, **task), damping=adapting("sigma_min"))
    other = controller(robot, hand(robot, **served), damping=adapting("sigma_min"))
    q = np.array([0.3, 0.9, -0.4, 0.5])[: made.problem.model.nq]
    for each in (made, other):
        each.step(q)
    assert not made.engine.assembly.damped
    sigma = made.engine.assembly.sigma_min()
    assert sigma > 0.1
    assert sigma == pytest.approx(other.engine.assembly.sigma_min(), rel=1e-6)


def test_an_axis_that_is_aligned_is_not_singular_for_its_free_roll() -> None:
    axis = {"name": "axis", "type": "axis_align", "frame": {"site": "hand"}}
    made = controller("panda", axis, damping=adapting("sigma_min"))
    made.step()
    assert not made.engine.assembly.damped
    assert made.engine.assembly.sigma_min() > 0.5


def test_a_row_that_vanishes_at_a_singularity_counts() -> None:
    # The arm lies along x: the row of x is zero here, and nowhere around.
    task = hand("planar_3r", B=PLANE_ALONE, axes="world")
    made = controller("planar_3r", task, damping=adapting("sigma_min"))
    made.step(np.zeros(3))
    assert made.engine.assembly.sigma_min() == 0.0
    assert made.engine.assembly.damping == pytest.approx(np.hypot(FLOOR, LARGEST))


def test_a_far_target_damps_no_more_than_the_largest_and_a_reached_one_not_at_all() -> None:
    made = controller("planar_3r", hand("planar_3r"), damping=adapting("error"), limits={})
    for distance in (10.0, 1e6):
        made.set_target("hand", [distance, 0.0, 0.0])
        step = made.step()
        assert made.engine.assembly.damping == pytest.approx(np.hypot(FLOOR, LARGEST))
        assert np.abs(step.v).max() > 1.0  # it goes there
    made.reset()
    made.step()
    assert made.engine.assembly.damping == pytest.approx(FLOOR)
    assert not made.engine.assembly.damped


@each_way
@pytest.mark.parametrize("scale", [1e-8, 1e6])
def test_the_unit_of_the_weights_changes_nothing(adapt: str, scale: float) -> None:
    def rate(unit: float) -> Array:
        task = hand("panda", B=unit)
        # w of six rows is in the sixth power of √B.
        power = 6 if adapt == "manipulability" else 1
        damping = {
            "lambda": FLOOR * unit**0.5,
            "adapt": adapt,
            "largest": LARGEST * unit**0.5,
            "threshold": 0.5 * unit ** (0.5 * power),
        }
        made = controller("panda", task, damping=damping)
        made.set_target("hand", made.problem.term["hand"].target[4:] + 0.1)
        v = made.step().v
        assert made.engine.assembly.damped
        assert made.engine.assembly.damping > FLOOR * unit**0.5
        return v

    assert rate(scale) == pytest.approx(rate(1.0), abs=SAME_OPTIMUM)


def test_a_decomposition_that_fails_damps_the_most(monkeypatch: pytest.MonkeyPatch) -> None:
    made = controller("panda", hand("panda"), damping=adapting("sigma_min"), engine="python")

    def failing(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", failing)
    step = made.step()
    assert made.engine.assembly.damping == pytest.approx(np.hypot(FLOOR, LARGEST))
    assert np.isfinite(step.v).all()


def test_looking_for_the_rank_leaves_the_start_in_place() -> None:
    made = controller("ur5e", hand("ur5e"), damping=adapting("sigma_min"))
    evaluation = made.engine.evaluation
    assert evaluation.data.qpos == pytest.approx(made.problem.start, abs=0.0)
    assert np.abs(evaluation.error).max() < ROUNDING
