"""The closed forms obey the identities that define them, for random and rank-deficient Jacobians.

Properties of the pseudo-inverse, the weighted and the damped least squares, the adaptive damping,
the null space and the priorities.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from rmrc import reference
from rmrc.reference.damped import FACTORIZATIONS, FORMS

# Relative to the size of the numbers compared: rounding, times condition numbers up to 1e6.
EXACT = 1e-9
# Projectors and step bounds have entries of order 1 and no condition number.
ROUNDING = 1e-12

SHAPES = [(1, 1), (2, 2), (2, 3), (3, 7), (6, 6), (6, 7), (3, 30)]

shapes = st.sampled_from(SHAPES)
numbers = st.integers(0, 2**31)
losses = st.integers(0, 2)
dampings = st.floats(0.01, 2.0)


def examples(count: int = 100):
    """Return the decorator of a property: seeded, and without a deadline that load could break."""
    return lambda test: seed(0)(settings(max_examples=count, deadline=None)(test))


def random_task(
    shape: tuple[int, int], number: int, lost: int = 0
) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Return a Jacobian of singular values in [0.1, 3] (0 for those lost), ẋ and the generator."""
    rng = np.random.default_rng(number)
    U, _, Vt = np.linalg.svd(rng.normal(size=shape), full_matrices=False)
    sigma = rng.uniform(0.1, 3.0, min(shape))
    sigma[:lost] = 0.0
    return U * sigma @ Vt, rng.normal(size=shape[0]), rng


def definite(rng: np.random.Generator, size: int) -> np.ndarray:
    """Return a symmetric positive definite matrix of a condition below about 1e3."""
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    return root @ root.T + 0.05 * np.eye(size)


def assert_close(actual, expected, tolerance: float = EXACT) -> None:
    size = max(1.0, float(abs(np.asarray(expected)).max()))
    assert abs(np.asarray(actual) - expected).max() <= tolerance * size


@examples()
@given(shapes, numbers, losses)
def test_pinv_has_the_least_norm_of_all_solutions(shape, number, lost) -> None:
    J, xdot, rng = random_task(shape, number, lost)
    v, N = reference.pinv(J, xdot), reference.nullspace_projector(J)
    # Nearest to the task: the residual is orthogonal to everything that J can do.
    assert_close(J.T @ (J @ v - xdot), np.zeros(shape[1]))
    other = v + N @ rng.normal(size=shape[1])
    assert_close(J @ other, J @ v)
    assert np.linalg.norm(v) <= np.linalg.norm(other) + ROUNDING


@examples()
@given(shapes, numbers)
def test_every_inverse_agrees_where_it_is_defined(shape, number) -> None:
    J, xdot, _ = random_task(shape, number)
    v = reference.pinv(J, xdot)
    assert_close(J @ v, xdot)
    assert_close(reference.pinv(J, xdot, form="right"), v)
    assert_close(reference.weighted(J, xdot, 2.5), v)
    assert_close(reference.weighted(J, xdot, np.full(shape[1], 0.3)), v)
    assert_close(reference.dls(J, xdot, 0.0), v)
    assert_close(reference.prioritized([(J, xdot)]), v)
    assert_close(reference.saturated(J, xdot, -np.inf, np.inf), v)
    if shape[0] == shape[1]:
        assert_close(reference.inverse(J, xdot), v)


@examples()
@given(shapes, numbers, losses, st.floats(0.0, 3.0))
def test_optimal_transpose_is_the_nearest_along_its_direction(shape, number, lost, factor) -> None:
    J, xdot, _ = random_task(shape, number, lost)
    best = np.linalg.norm(xdot - J @ reference.transpose(J, xdot))
    optimal = reference.transpose(J, xdot)
    gain = factor * optimal.dot(optimal) / max(optimal.dot(J.T @ xdot), 1e-300)
    assert best <= np.linalg.norm(xdot - J @ reference.transpose(J, xdot, gain)) + ROUNDING


@examples()
@given(shapes, numbers)
def test_weighted_has_the_least_weighted_norm(shape, number) -> None:
    J, xdot, rng = random_task(shape, number)
    A = definite(rng, shape[1])
    v = reference.weighted(J, xdot, A)
    assert_close(J @ v, xdot)
    # Stationary: moving in the null space does not change ½vᵀAv.
    assert_close(reference.nullspace_projector(J) @ A @ v, np.zeros(shape[1]), 1e-7)


@examples()
@given(st.integers(2, 8), numbers)
def test_task_metric_moves_the_other_task_the_least(size, number) -> None:
    J, xdot, rng = random_task((size // 2, size), number)
    other, _, _ = random_task((size, size), number + 1)
    B = definite(rng, size)
    v = reference.weighted(J, xdot, reference.task_metric(other, B))
    alternative = v + reference.nullspace_projector(J) @ rng.normal(size=size)

    def moved(v: np.ndarray) -> float:
        return float((other @ v) @ B @ (other @ v))

    assert_close(J @ v, xdot)
    assert moved(v) <= moved(alternative) * (1.0 + EXACT)


def test_task_metric_of_a_redundant_arm_needs_damping() -> None:
    J, _, _ = random_task((2, 3), 0)
    with pytest.raises(ValueError, match=r"JᵀBJ is singular, of rank 2 for 3 joints"):
        reference.task_metric(J, 1.0)
    assert_close(
        reference.task_metric(J, [4.0, 1.0], 0.1), J.T @ np.diag([4, 1]) @ J + 0.01 * np.eye(3)
    )


@examples()
@given(shapes, numbers, losses, dampings)
def test_primal_is_dual_and_factorizations_agree(shape, number, lost, damping) -> None:
    J, xdot, _ = random_task(shape, number, lost)
    expected = np.linalg.lstsq(
        np.vstack((J, damping * np.eye(shape[1]))), np.append(xdot, np.zeros(shape[1]))
    )[0]
    for form, factorization in product(FORMS, FACTORIZATIONS):
        assert_close(reference.dls(J, xdot, damping, form, factorization), expected)


@examples()
@given(shapes, numbers, st.sampled_from([1.0, 1e-1, 1e-2, 1e-3, 1e-4]))
def test_damping_approaches_the_pseudo_inverse_at_its_rate(shape, number, damping) -> None:
    J, xdot, _ = random_task(shape, number)
    _, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    v = reference.pinv(J, xdot)
    rate = damping**2 / (sigma**2 + damping**2)
    short = Vt @ (v - reference.dls(J, xdot, damping, factorization="svd"))
    assert abs(short - rate * (Vt @ v)).max() <= ROUNDING * max(1.0, abs(v).max())


@examples()
@given(shapes, numbers, losses, dampings)
def test_damped_step_is_bounded(shape, number, lost, damping) -> None:
    J, xdot, _ = random_task(shape, number, lost)
    bound = reference.step_bound(xdot, damping)
    assert np.linalg.norm(reference.dls(J, xdot, damping)) <= bound * (1.0 + ROUNDING)
    # Attained where the damping is the singular value and the task its direction.
    U, sigma, _ = np.linalg.svd(J)
    if sigma[0] > 0.0:
        worst = np.linalg.norm(reference.dls(J, U[:, 0], sigma[0]))
        assert_close(worst, reference.step_bound(U[:, 0], sigma[0]))


@examples()
@given(shapes, numbers, losses)
def test_damping_trades_error_for_rate(shape, number, lost) -> None:
    J, xdot, _ = random_task(shape, number, lost)
    steps = [reference.dls(J, xdot, damping) for damping in np.geomspace(0.01, 10.0, 12)]
    errors = [np.linalg.norm(xdot - J @ v) for v in steps]
    rates = [np.linalg.norm(v) for v in steps]
    assert all(np.diff(errors) >= -ROUNDING)
    assert all(np.diff(rates) <= ROUNDING)


@examples()
@given(shapes, numbers, losses, dampings)
def test_weighted_dls_is_the_least_squares_of_its_terms(shape, number, lost, damping) -> None:
    J, xdot, rng = random_task(shape, number, lost)
    A, B = definite(rng, shape[1]), definite(rng, shape[0])
    root_A, root_B = np.linalg.cholesky(A).T, np.linalg.cholesky(B).T
    expected = np.linalg.lstsq(
        np.vstack((root_B @ J, root_A, damping * np.eye(shape[1]))),
        np.concatenate((root_B @ xdot, np.zeros(2 * shape[1]))),
    )[0]
    assert_close(reference.weighted_dls(J, xdot, A, B, damping), expected)
    assert_close(
        reference.weighted_dls(J, xdot, 0.0, 1.0, damping), reference.dls(J, xdot, damping)
    )


@examples()
@given(shapes, numbers, losses)
def test_nullspace_projector_is_a_projector(shape, number, lost) -> None:
    J, _, _ = random_task(shape, number, lost)
    N = reference.nullspace_projector(J)
    for zero in (J @ N, N @ N - N, N - N.T):
        assert abs(zero).max() <= ROUNDING
    assert_close(np.trace(N), shape[1] - np.linalg.matrix_rank(J))


@examples()
@given(shapes, numbers, st.floats(0.0, 3.0))
def test_adaptive_damping_follows_its_formula(shape, number, threshold) -> None:
    threshold += 1e-3
    J, xdot, rng = random_task(shape, number)
    sigma_min = np.linalg.norm(J, -2)
    w = np.sqrt(np.linalg.det(J @ J.T))
    by_sigma = reference.damping_sigma_min(J, 0.2, threshold)
    assert_close(by_sigma**2, 0.04 * max(0.0, 1.0 - (sigma_min / threshold) ** 2))
    by_manipulability = reference.damping_manipulability(J, 0.2, threshold)
    assert_close(by_manipulability, 0.2 * max(0.0, 1.0 - w / threshold))
    B = definite(rng, shape[0])
    assert_close(reference.damping_error(xdot, 0.1, B) ** 2, 0.5 * xdot @ B @ xdot + 0.01)


@examples()
@given(shapes, numbers)
def test_adaptive_damping_is_its_maximum_at_a_singularity(shape, number) -> None:
    J, _, _ = random_task(shape, number, lost=1)
    assert_close(reference.damping_sigma_min(J, 0.2, 0.5), 0.2)
    assert_close(reference.damping_manipulability(J, 0.2, 0.5), 0.2)
    assert reference.damping_error(np.zeros(shape[0]), 0.2) == 0.2


@examples()
@given(shapes, numbers, st.integers(0, 1), dampings, st.floats(0.01, 1.0))
def test_numerical_filtering_damps_one_direction(shape, number, lost, filtering, damping) -> None:
    J, xdot, _ = random_task(shape, number, lost)
    u = np.linalg.svd(J)[0][:, -1]
    matrix = J @ J.T + damping**2 * np.eye(shape[0]) + filtering**2 * np.outer(u, u)
    v = reference.numerically_filtered(J, xdot, filtering, damping)
    assert_close(v, J.T @ np.linalg.solve(matrix, xdot))
    # Alone, it leaves every other direction as exact as the pseudo-inverse does.
    v = reference.numerically_filtered(J, xdot, filtering)
    others = np.eye(shape[0]) - np.outer(u, u)
    assert_close(others @ (J @ v), others @ (J @ reference.pinv(J, xdot)))


@examples()
@given(shapes, numbers, losses, st.floats(1e-3, 10.0))
def test_selective_damping_is_its_definition(shape, number, lost, limit) -> None:
    J, error, _ = random_task(shape, number, lost)
    blocks = [slice(k, k + 3) for k in range(0, len(J), 3)] if len(J) % 3 == 0 else [slice(None)]
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)

    def clamped(step: np.ndarray, largest: float) -> np.ndarray:
        return step * min(1.0, largest / max(abs(step).max(), 1e-300))

    total = np.zeros(shape[1])
    for u, s, v in zip(U.T, sigma, Vt, strict=True):
        if s > EXACT:
            reach = sum(np.linalg.norm(u[rows]) for rows in blocks)
            effort = sum(
                abs(v[j]) * np.linalg.norm(J[rows, j]) / s
                for rows in blocks
                for j in range(shape[1])
            )
            total += clamped(u @ error / s * v, min(1.0, reach / effort) * limit)
    step = reference.selectively_damped(J, error, limit)
    assert_close(step, clamped(total, limit))
    assert abs(step).max() <= limit * (1.0 + ROUNDING)


@examples()
@given(
    st.sampled_from([(1, 2, 7), (2, 2, 3), (3, 3, 7), (6, 3, 7), (3, 6, 30)]),
    numbers,
    losses,
)
def test_priorities_leave_the_level_above_undisturbed(sizes, number, lost) -> None:
    first, second, columns = sizes
    J1, xdot1, _ = random_task((first, columns), number, lost)
    J2, xdot2, _ = random_task((second, columns), number + 1, lost)
    v1 = reference.pinv(J1, xdot1)
    N = reference.nullspace_projector(J1)
    v = reference.prioritized([(J1, xdot1), (J2, xdot2)])
    assert_close(J1 @ v, J1 @ v1)
    # The second level is as near as the null space of the first lets it be.
    rest = np.linalg.lstsq(J2 @ N, xdot2 - J2 @ v1, rcond=EXACT)[0]
    assert_close(v, v1 + rest)
    damped = reference.prioritized([(J1, xdot1), (J2, xdot2)], damping=0.1)
    assert_close(J1 @ damped, J1 @ reference.dls(J1, xdot1, 0.1))


@examples(50)
@given(numbers)
def test_a_conflicting_level_changes_nothing(number) -> None:
    J, xdot, rng = random_task((3, 7), number)
    combined = rng.normal(size=(2, 3)) @ J
    last, xdot_last, _ = random_task((2, 7), number + 1)
    without = reference.prioritized([(J, xdot), (last, xdot_last)])
    levels = [(J, xdot), (combined, rng.normal(size=2)), (last, xdot_last)]
    assert_close(reference.prioritized(levels), without)


@examples(20)
@given(numbers, st.sampled_from([1e-3, 1e-6, 1e-8]))
def test_priorities_hold_where_a_level_is_nearly_lost(number, tilt) -> None:
    axes = np.linalg.qr(np.random.default_rng(number).normal(size=(7, 7))).Q
    rows = [axes[:1], axes[:1] + tilt * axes[1:2], axes[2:4]]
    v = reference.prioritized(zip(rows, ([1.0], [0.0], [1.0, 2.0]), strict=True))
    expected = axes[0] - axes[1] / tilt + axes[2] + 2.0 * axes[3]
    # The tilt is known to ε/tilt; what is above and below it is not touched by that.
    assert_close(v, expected, ROUNDING / tilt)
    for row in (0, 2, 3):
        assert_close(axes[row] @ v / abs(v).max(), axes[row] @ expected / abs(v).max(), ROUNDING)


SCALES = (1e-150, 1e-100, 1e-83, 1e-20, 1e20, 1e70, 1e100, 1e150)
# The primal form squares a condition of 10 and loses as many digits; the rest is rounding.
SAME_DIGITS = 1e-10
LU = [("dual", "lu"), ("primal", "lu"), ("dual", "cholesky"), ("primal", "qr"), ("dual", "svd")]


@pytest.mark.parametrize("scale", SCALES)
def test_the_scale_of_the_jacobian_is_no_singularity(scale: float) -> None:
    rng = np.random.default_rng(0)
    J, xdot = rng.normal(size=(3, 5)), rng.normal(size=3)
    closed = {
        "transpose": lambda s: reference.transpose(s * J, xdot),
        "pinv": lambda s: reference.pinv(s * J, xdot),
        "right": lambda s: reference.pinv(s * J, xdot, form="right"),
        "inverse": lambda s: reference.inverse(s * J[:, :3], xdot),
        "weighted": lambda s: reference.weighted(s * J, xdot, np.arange(1.0, 6.0)),
        "saturated": lambda s: reference.saturated(s * J, xdot, -0.3 / s, 0.3 / s),
        "bounded": lambda s: reference.bounded_dls(s * J, xdot, -0.3 / s, 0.3 / s, 0.1 * s),
        **{
            f"{form} {by}": lambda s, form=form, by=by: reference.dls(
                s * J,
                xdot,
                0.1 * s,
                form,  # pyright: ignore[reportArgumentType]
                by,  # pyright: ignore[reportArgumentType]
            )
            for form, by in LU
        },
        "weighted_dls": lambda s: reference.weighted_dls(s * J, xdot, 0.0, 1.0, 0.1 * s),
    }
    for name, method in closed.items():
        assert scale * method(scale) == pytest.approx(method(1.0), rel=SAME_DIGITS), name


@pytest.mark.parametrize("condition", [1e2, 1e4, 1e6])
def test_weighted_keeps_the_digits_that_the_jacobian_has(condition: float) -> None:
    """The normal equations lost twice as many: 1.5e-4 at a condition of 1e6."""
    rng = np.random.default_rng(1)
    U, V = (np.linalg.qr(rng.normal(size=(n, n))).Q for n in (6, 7))
    J = U @ np.diag(np.geomspace(1.0, 1.0 / condition, 6)) @ V[:6]
    A = rng.uniform(0.1, 3.0, 7)
    v = J.T @ rng.normal(size=6) / A  # A v is in the range of Jᵀ, so that no other has less
    found = reference.weighted(J, J @ v, A)
    assert np.abs(found - v).max() < 1e-14 * condition * np.abs(v).max()
