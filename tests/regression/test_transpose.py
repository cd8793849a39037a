"""The transpose is slower than the inverse near the goal, and calm where the inverse blows up."""

from dataclasses import replace

import mink
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from random_robots import (
    Moment,
    Robot,
    asked,
    assert_close,
    each_robot,
    examples,
    numbers,
    planar_arm,
    random_moment,
    random_robot,
    unit_links,
)

# Where the goal is reached, m: what the inverse needs three steps for.
REACHED = 1e-6
MOST = 1000
# Of the iterations that steepest descent needs in a plane without curvature.
PREDICTED = 0.1
# Rounding, times conditions up to 1e4.
SAME_STEP = 1e-9
LEAST_SIGMA = 0.02

elbows = st.floats(0.5, 2.5)


def two_links(rng: np.random.Generator, folder) -> Robot:
    """Return an arm of two random links, asked for its hand's position in the world's axes."""
    return planar_arm(rng.uniform(0.3, 1.2, 2), folder)


def directions(arm: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the hand's position, and U (3, 2) and σ of its Jacobian."""
    controller = arm.controller(arm.hand(axes="world"))
    controller.step(q)
    left, sigma, _ = np.linalg.svd(asked(controller)[0])
    position = controller.problem.forward(q)["hand"][:3, 3]
    return position, np.vstack([left, np.zeros(2)]), sigma


def iterations(arm: Robot, method: str, q: np.ndarray, target: np.ndarray) -> int:
    """Return how many whole steps from q bring the hand to a point."""
    controller = arm.controller(arm.hand(axes="world", gain="deadbeat"), method=method)
    assert controller.set_target("hand", target)
    for count in range(MOST):
        step = controller.step(q)
        if step.error["hand"][0] <= REACHED:
            return count
        q = step.q
    return MOST


@examples(25)
@given(numbers, elbows)
def test_the_transpose_needs_more_iterations_than_the_inverse(
    tmp_path_factory, number, elbow
) -> None:
    # Steepest descent shrinks its least favourable error, along u₁ + κ u₂, by (κ² − 1)/(κ² + 1).
    rng = np.random.default_rng(number)
    arm = two_links(rng, tmp_path_factory.getbasetemp())
    q = np.array([rng.uniform(-2.0, 2.0), elbow])
    position, left, sigma = directions(arm, q)
    condition = sigma[0] / sigma[1]
    assume(2.0 <= condition <= 8.0)
    distance = 0.01 * sigma[1]
    target = position + distance * (left @ [1.0, condition]) / np.hypot(1.0, condition)
    inverse, transpose = (iterations(arm, m, q, target) for m in ("inverse", "transpose"))
    shrinking = (condition**2 - 1.0) / (condition**2 + 1.0)
    assert inverse <= 3
    assert transpose == pytest.approx(np.log(REACHED / distance) / np.log(shrinking), rel=PREDICTED)


def singular(arm: Robot, method: str, elbow: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return v and σ for 1 m/s, of which the lost direction u₂ has a share, at an elbow's angle."""
    q = np.array([0.4, elbow])
    position, left, sigma = directions(arm, q)
    controller = arm.controller(arm.hand(axes="world"), method=method)
    twist = np.zeros(6)
    twist[:3] = left @ [np.sqrt(1.0 - share**2), share]
    assert controller.set_target("hand", position, velocity=twist)
    return controller.step(q).v, sigma


@examples(25)
@given(numbers, st.floats(-8.0, -1.0))
def test_the_transpose_does_not_blow_up_at_the_singularity(
    tmp_path_factory, number, exponent
) -> None:
    # ‖v‖ = ‖Jᵀẋ‖³/‖JJᵀẋ‖² ≤ ‖ẋ‖³/(σ₁ ⟨u₁, ẋ⟩²), which is 2/σ₁ here, and the inverse's ≥ ⟨u₂, ẋ⟩/σ₂.
    arm = two_links(np.random.default_rng(number), tmp_path_factory.getbasetemp())
    calm, sigma = singular(arm, "transpose", 10.0**exponent, np.sqrt(0.5))
    assert np.linalg.norm(calm) <= 2.0 / sigma[0] * (1.0 + SAME_STEP)
    wild, _ = singular(arm, "inverse", 10.0**exponent, np.sqrt(0.5))
    assert np.linalg.norm(wild) >= np.sqrt(0.5) / sigma[1] * (1.0 - 1e-6)


def test_a_tenth_of_the_elbows_angle_is_ten_times_the_inverses_rate() -> None:
    arm, half = unit_links(2), np.sqrt(0.5)
    elbows = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5]
    wild, calm = (
        [float(np.linalg.norm(singular(arm, method, elbow, half)[0])) for elbow in elbows]
        for method in ("inverse", "transpose")
    )
    assert wild == pytest.approx([15.8, 158, 1581, 15811, 158114], rel=2e-3)  # √(5/2)/elbow
    assert calm == pytest.approx([0.3165] * 5, rel=2e-3)  # 1/√10
    # Straight, the inverse has no answer, and the transpose still the same.
    assert not singular(arm, "inverse", 0.0, half)[0].any()
    assert np.linalg.norm(singular(arm, "transpose", 0.0, half)[0]) == pytest.approx(np.sqrt(0.1))


def test_in_the_lost_direction_alone_the_optimal_transpose_is_the_inverse() -> None:
    for elbow in (1e-1, 1e-2, 1e-3):
        v, sigma = singular(unit_links(2), "transpose", elbow, 1.0)
        assert np.linalg.norm(v) == pytest.approx(1.0 / sigma[1], rel=1e-6)


@each_robot
@examples(15)
@given(numbers)
def test_descent_is_the_transpose_where_its_first_step_is_taken(
    robot, tmp_path_factory, number
) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    task = arm.hand(gain="deadbeat")
    transpose, descent = (arm.controller(task, method=m) for m in ("transpose", "descent"))
    q = random_moment(transpose, rng).q
    pose = mink.SE3.from_matrix(transpose.problem.forward(q)["hand"])
    near = Moment(q, pose @ mink.SE3.exp(1e-5 * rng.normal(size=6)), None)
    v = near.step(transpose).v
    assume(np.linalg.svd(asked(transpose)[0], compute_uv=False)[-1] >= LEAST_SIGMA)
    assert_close(near.step(descent).v, v, SAME_STEP)


@each_robot
@examples(15)
@given(numbers)
def test_descent_never_steps_away_from_its_target(robot, tmp_path_factory, number) -> None:
    rng = np.random.default_rng(number)
    arm = random_robot(robot, rng, tmp_path_factory.getbasetemp())
    descent = arm.controller(arm.hand(), method="descent")
    moment = random_moment(descent, rng)
    rows = list(arm.rows)
    lengths = []
    for _ in range(5):
        moment = replace(moment, q=moment.step(descent).q)
        lengths.append(np.linalg.norm(descent.engine.evaluation.error[rows]))
    assert all(np.diff(lengths) < 0.0)
