"""The certificate: each residual by hand, and what it must never let through."""

from math import inf, isfinite, nan, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from rmrc.qp.certificate import Certificate
from rmrc.qp.program import KKT, QP, UNCERTIFIED, Solution, SolveStatus

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Of residuals of the order of 1 to 100, computed in another order than the certificate's."""


def unit_box(n: int = 2, rows: int = 0, equalities: int = 0) -> QP:
    """Return the program of the point of the box |v| ≤ 1 nearest to g = 0."""
    qp = QP(n, rows, equalities)
    qp.H[:] = np.eye(n)
    qp.lb[:], qp.ub[:] = -1.0, 1.0
    return qp


def answer(
    qp: QP,
    v: list[float],
    z: list[float] | None = None,
    y: list[float] | None = None,
    w: list[float] | None = None,
) -> Solution:
    solution = Solution.at_rest(qp, SolveStatus.SOLVED)
    for part, values in (
        (solution.v, v),
        (solution.bound_multiplier, z),
        (solution.row_multiplier, y),
        (solution.equality_multiplier, w),
    ):
        if values is not None:
            part[:] = values
    return solution


def certified(qp: QP, solution: Solution) -> KKT:
    largest = Certificate(qp).certify(solution)
    assert largest == solution.kkt.largest == max(solution.kkt)
    return solution.kkt


def test_an_optimum_has_no_residual() -> None:
    qp = unit_box()
    qp.g[:] = [-3.0, 3.0]
    assert certified(qp, answer(qp, [1.0, -1.0], [2.0, -2.0])) == KKT(0.0, 0.0, 0.0)


def test_v_is_clipped_in_place_and_the_way_it_moved_is_primal() -> None:
    qp = unit_box(3)
    qp.g[:] = [-1.0, 0.5, 1.0]
    solution = answer(qp, [1.3, -0.5, -1.4])
    v = solution.v
    kkt = certified(qp, solution)
    assert v is solution.v
    assert v.tolist() == [1.0, -0.5, -1.0]
    assert kkt.primal == pytest.approx(0.5, abs=ROUNDING)
    assert kkt.dual == 0.0  # of the clipped v


@pytest.mark.parametrize("excess", [1e-16, 1e-12, 1e-6])
def test_a_limit_is_not_passed_by_the_least_amount(excess: float) -> None:
    qp = unit_box(1)
    solution = answer(qp, [float(np.nextafter(1.0, 2.0)) + excess])
    certified(qp, solution)
    assert solution.v[0] == 1.0


def test_the_dual_residual_is_the_two_norm_of_the_gradient() -> None:
    qp = unit_box()
    qp.g[:] = [3.0, 4.0]
    assert certified(qp, answer(qp, [0.0, 0.0])) == KKT(0.0, 5.0, 0.0)


@pytest.mark.parametrize(
    ("v", "z", "slackness"),
    [(0.75, 2.0, 0.5), (0.75, -2.0, 3.5), (1.0, -2.0, 4.0), (1.0, 2.0, 0.0)],
)
def test_a_multiplier_away_from_its_limit_is_not_complementary(
    v: float, z: float, slackness: float
) -> None:
    qp = unit_box(1)
    qp.g[:] = -v - z
    assert certified(qp, answer(qp, [v], [z])) == KKT(0.0, 0.0, slackness)


@pytest.mark.parametrize(("lower", "upper", "z"), [(-inf, 1.0, -2.0), (-1.0, inf, 2.0)])
def test_a_multiplier_of_an_infinite_bound_is_dual(lower: float, upper: float, z: float) -> None:
    qp = unit_box(2)
    qp.lb[0], qp.ub[0] = lower, upper
    qp.g[:] = [-z, 1.0]  # balanced by z, and by v = −1
    assert certified(qp, answer(qp, [0.0, -1.0], [z, 0.0])) == KKT(0.0, 2.0, 0.0)


def test_an_infinite_bound_without_a_multiplier_costs_nothing() -> None:
    qp = unit_box(2)
    qp.lb[0], qp.ub[0] = -inf, inf
    qp.g[:] = [-5.0, -3.0]
    assert certified(qp, answer(qp, [5.0, 1.0], [0.0, 2.0])) == KKT(0.0, 0.0, 0.0)


def test_rows_and_equalities_are_measured_on_both_sides() -> None:
    qp = unit_box(2, rows=2, equalities=1)
    qp.C[:], qp.lo[:], qp.hi[:] = [[1.0, 1.0], [1.0, -1.0]], [-0.5, 0.25], [0.5, 0.5]
    qp.E[:], qp.f[:] = [[1.0, 0.0]], [0.0]
    kkt = certified(qp, answer(qp, [0.5, 0.5]))  # C v = (1, 0), E v = 0.5
    assert kkt.primal == pytest.approx(sqrt(0.5**2 + 0.25**2 + 0.5**2), abs=ROUNDING)
    assert kkt.dual == pytest.approx(sqrt(0.5), abs=ROUNDING)


def test_the_multipliers_of_rows_and_equalities_balance_the_gradient() -> None:
    qp = unit_box(2, rows=1, equalities=1)
    qp.C[:], qp.lo[:], qp.hi[:] = [[1.0, 2.0]], [-inf], [0.5]
    qp.E[:], qp.f[:] = [[1.0, -1.0]], [0.5]
    v, y, w = np.array([0.5, 0.0]), np.array([3.0]), np.array([-4.0])
    qp.g[:] = -(v + y @ qp.C + w @ qp.E)
    assert certified(qp, answer(qp, [*v], None, [*y], [*w])) == KKT(0.0, 0.0, 0.0)
    # At the side where there is no limit the same multiplier is stray.
    qp.g[:] += 2.0 * y @ qp.C
    assert certified(qp, answer(qp, [*v], None, [*-y], [*w])) == KKT(0.0, 3.0, 0.0)


def test_a_row_multiplier_away_from_its_limit_is_not_complementary() -> None:
    qp = unit_box(1, rows=1)
    qp.C[:], qp.lo[:], qp.hi[:], qp.g[:] = 1.0, -1.0, 1.0, -2.0
    assert certified(qp, answer(qp, [0.0], None, [2.0])) == KKT(0.0, 0.0, 2.0)
    qp.g[:] = 2.0
    assert certified(qp, answer(qp, [0.5], None, [-2.5])) == KKT(0.0, 0.0, 2.5 * 1.5)


@pytest.mark.parametrize("wrong", [nan, inf, -inf])
@pytest.mark.parametrize(
    "where", ["v", "bound_multiplier", "row_multiplier", "equality_multiplier"]
)
def test_a_solution_that_is_not_finite_has_infinite_residuals(where: str, wrong: float) -> None:
    qp = unit_box(2, rows=1, equalities=1)
    solution = answer(qp, [0.0, 0.0])
    getattr(solution, where)[0] = wrong
    assert certified(qp, solution) is UNCERTIFIED


@pytest.mark.parametrize("wrong", [nan, inf, 1e300])
@pytest.mark.parametrize("where", ["H", "g", "C", "E", "f"])
def test_a_program_that_is_not_finite_has_infinite_residuals(where: str, wrong: float) -> None:
    qp = unit_box(2, rows=1, equalities=1)
    getattr(qp, where).flat[0] = wrong
    kkt = certified(qp, answer(qp, [0.5, 0.5], [1.0, 1.0], [1.0], [1.0]))
    assert kkt is UNCERTIFIED


@pytest.mark.parametrize("where", ["lb", "ub", "lo", "hi"])
def test_a_limit_that_is_not_a_number_has_infinite_residuals(where: str) -> None:
    qp = unit_box(2, rows=1)
    qp.lo[:], qp.hi[:] = -1.0, 1.0
    getattr(qp, where)[0] = nan
    assert certified(qp, answer(qp, [0.5, 0.5], [1.0, 1.0], [1.0])) is UNCERTIFIED


def test_a_velocity_that_is_not_a_number_is_not_turned_into_a_limit() -> None:
    qp = unit_box(2)
    solution = answer(qp, [nan, 2.0])
    certified(qp, solution)
    assert np.isnan(solution.v[0])


def test_the_buffers_are_read_at_every_call() -> None:
    qp = unit_box(1)
    certificate, solution = Certificate(qp), answer(qp, [0.5])
    assert certificate.certify(solution) == 0.5
    qp.g[:] = -0.5
    assert certificate.certify(solution) == 0.0
    qp.ub[:] = 0.25
    assert certificate.certify(solution) == 0.25
    assert solution.v[0] == 0.25


def by_definition(qp: QP, s: Solution) -> KKT:
    """Return the residuals as the docstring of `KKT` states them, element by element."""
    v = np.clip(s.v, qp.lb, qp.ub)
    activity = qp.C @ v
    inside = np.clip(activity, qp.lo, qp.hi)
    primal = np.concatenate([s.v - v, activity - inside, qp.E @ v - qp.f])
    gradient = qp.H @ v + qp.g + s.bound_multiplier
    gradient += qp.C.T @ s.row_multiplier + qp.E.T @ s.equality_multiplier
    stray, slackness = 0.0, 0.0
    for x, lower, upper, multiplier in (
        *zip(v, qp.lb, qp.ub, s.bound_multiplier, strict=True),
        *zip(inside, qp.lo, qp.hi, s.row_multiplier, strict=True),
    ):
        limit = upper if multiplier > 0.0 else lower
        if isfinite(limit):
            slackness += abs(multiplier * (limit - x))
        else:
            stray += multiplier**2
    return KKT(float(np.linalg.norm(primal)), sqrt(gradient @ gradient + stray), slackness)


@pytest.mark.parametrize(("n", "rows", "equalities"), [(1, 0, 0), (6, 4, 2), (7, 0, 0), (43, 9, 5)])
def test_random_residuals_are_those_of_the_definition(n: int, rows: int, equalities: int) -> None:
    rng = np.random.default_rng(n)
    qp = QP(n, rows, equalities)
    certificate = Certificate(qp)
    for _ in range(50):
        jacobian = rng.normal(size=(n, n))
        qp.H[:], qp.g[:] = jacobian.T @ jacobian, rng.normal(size=n)
        qp.C[:], qp.E[:] = rng.normal(size=qp.C.shape), rng.normal(size=qp.E.shape)
        qp.f[:] = rng.normal(size=equalities)
        for lower, upper in ((qp.lb, qp.ub), (qp.lo, qp.hi)):
            lower[:], upper[:] = -rng.random(lower.size), rng.random(lower.size)
            lower[rng.random(lower.size) < 0.2] = -inf
            upper[rng.random(lower.size) < 0.2] = inf
        solution = answer(
            qp,
            rng.normal(size=n).tolist(),
            (rng.normal(size=n) * (rng.random(n) < 0.5)).tolist(),
            rng.normal(size=rows).tolist(),
            rng.normal(size=equalities).tolist(),
        )
        expected = by_definition(qp, solution)
        certificate.certify(solution)
        np.testing.assert_allclose(solution.kkt, expected, rtol=ROUNDING, atol=ROUNDING)


def test_complementarity_bounds_the_objective_that_is_left() -> None:
    # With a zero dual residual, objective(v) − minimum ≤ complementarity (weak duality).
    rng = np.random.default_rng(1)
    qp = unit_box(7)
    for _ in range(100):
        target = 2.0 * rng.normal(size=7)
        qp.g[:] = -target
        best = np.clip(target, -1.0, 1.0)
        v = np.clip(best + 0.1 * rng.normal(size=7), -1.0, 1.0)
        kkt = certified(qp, answer(qp, v.tolist(), (target - v).tolist()))
        assert kkt.dual <= ROUNDING
        gap = 0.5 * (v @ v - best @ best) + qp.g @ (v - best)
        assert gap <= kkt.complementarity + ROUNDING
        assert gap > 0.0
