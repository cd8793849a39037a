"""A singular or mis-shaped argument raises a ValueError that says which argument and why."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from rmrc import reference
from rmrc.reference import planar_2r

WIDE = np.array([[1.0, 0.0, 1.0], [0.0, 2.0, 1.0]])
SINGULAR = np.array([[1.0, 2.0], [2.0, 4.0]])
PAIR = np.array([1.0, -1.0])

TAKES_A_TASK: dict[str, Callable] = {
    "inverse": reference.inverse,
    "transpose": reference.transpose,
    "pinv": reference.pinv,
    "weighted": lambda J, xdot: reference.weighted(J, xdot, 1.0),
    "dls": lambda J, xdot: reference.dls(J, xdot, 0.1),
    "weighted_dls": lambda J, xdot: reference.weighted_dls(J, xdot, 0.0, 1.0, 0.1),
    "numerically_filtered": lambda J, xdot: reference.numerically_filtered(J, xdot, 0.1),
    "saturated": lambda J, xdot: reference.saturated(J, xdot, -1.0, 1.0),
    "bounded_dls": lambda J, xdot: reference.bounded_dls(J, xdot, -1.0, 1.0, 0.1),
    "prioritized": lambda J, xdot: reference.prioritized([(J, xdot)]),
}
TAKES_A_JACOBIAN: dict[str, Callable] = {
    **{name: lambda J, call=call: call(J, PAIR) for name, call in TAKES_A_TASK.items()},
    "selectively_damped": lambda J: reference.selectively_damped(J, PAIR),
    "task_metric": lambda J: reference.task_metric(J, 1.0, 0.1),
    "nullspace_projector": reference.nullspace_projector,
    "damping_sigma_min": lambda J: reference.damping_sigma_min(J, 0.1, 0.1),
    "damping_manipulability": lambda J: reference.damping_manipulability(J, 0.1, 0.1),
}


@pytest.mark.parametrize("name", TAKES_A_JACOBIAN)
@pytest.mark.parametrize(
    ("J", "message"),
    [
        ([1.0, 2.0], r"J has shape \(2,\); it must be \(m, n\)"),
        (np.zeros((2, 0)), r"J has shape \(2, 0\)"),
        ([[1.0, math.nan], [0.0, 1.0]], "J has entries that are not finite"),
        ([[1.0, math.inf], [0.0, 1.0]], "J has entries that are not finite"),
        ([[1.0, 2.0], [3.0]], "J is not an array of numbers"),
        ("J", "J is not an array of numbers"),
    ],
)
def test_a_bad_jacobian_is_named(name, J, message) -> None:
    with pytest.raises(ValueError, match=message):
        TAKES_A_JACOBIAN[name](J)


@pytest.mark.parametrize("name", TAKES_A_TASK)
@pytest.mark.parametrize(
    ("xdot", "message"),
    [
        ([1.0, 2.0, 3.0], r"xdot has shape \(3,\); for J of shape \(2, 2\) it must be \(2,\)"),
        ([[1.0], [2.0]], r"xdot has shape \(2, 1\)"),
        ([1.0, math.nan], "xdot has entries that are not finite"),
        (None, r"xdot has shape \(\)|xdot is not an array"),
    ],
)
def test_a_bad_task_velocity_is_named(name, xdot, message) -> None:
    with pytest.raises(ValueError, match=message):
        TAKES_A_TASK[name](np.eye(2), xdot)


SKEW = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

MISTAKES: dict[str, tuple[Callable, str]] = {
    "inverse of a wide J": (
        lambda: reference.inverse(WIDE, PAIR),
        r"J has shape \(2, 3\); only a square J has an inverse",
    ),
    "inverse of a singular J": (lambda: reference.inverse(SINGULAR, PAIR), "J is singular"),
    "inverse of zero": (lambda: reference.inverse([[0.0]], [1.0]), "J is singular"),
    "negative gain": (lambda: reference.transpose(WIDE, PAIR, gain=-1.0), "gain is -1.0"),
    "unknown form of pinv": (
        lambda: reference.pinv(WIDE, PAIR, form="left"),  # pyright: ignore[reportArgumentType]
        "form is 'left'; it must be one of 'general', 'right'",
    ),
    "right inverse of a singular J": (
        lambda: reference.pinv(SINGULAR, PAIR, form="right"),
        "J: JJᵀ is singular",
    ),
    "tolerance of pinv": (
        lambda: reference.pinv(WIDE, PAIR, tolerance=1.0),
        "tolerance is 1.0; it must be ≥ 0 and < 1",
    ),
    "shape of A": (
        lambda: reference.weighted(WIDE, PAIR, [1.0, 1.0]),
        r"A has shape \(2,\); it must be a number, \(3,\) or \(3, 3\)",
    ),
    "A not symmetric": (lambda: reference.weighted(WIDE, PAIR, SKEW), "A is not symmetric"),
    "A singular": (
        lambda: reference.weighted(WIDE, PAIR, [1.0, 1.0, 0.0]),
        "A is not positive definite",
    ),
    "A indefinite": (
        lambda: reference.weighted(WIDE, PAIR, [1.0, 1.0, -1.0]),
        "A is not positive definite",
    ),
    "A not finite": (
        lambda: reference.weighted(WIDE, PAIR, math.inf),
        "A has entries that are not",
    ),
    "weighted with a singular J": (
        lambda: reference.weighted(SINGULAR, PAIR, 1.0),
        "J: JA⁻¹Jᵀ is singular, J lacks full row rank",
    ),
    "task metric of a wide J": (
        lambda: reference.task_metric(WIDE, 1.0),
        "J, B: the metric A = JᵀBJ is singular, of rank 2 for 3 joints",
    ),
    "B semi-definite": (
        lambda: reference.task_metric(np.eye(2), [1.0, 0.0]),
        "JᵀBJ is singular, of rank 1 for 2 joints",
    ),
    "B indefinite": (
        lambda: reference.weighted_dls(WIDE, PAIR, 0.0, [[1.0, 2.0], [2.0, 1.0]], 0.1),
        "B is not positive semi-definite: its least eigenvalue is -1",
    ),
    "A negative": (
        lambda: reference.weighted_dls(WIDE, PAIR, -1.0, 1.0, 0.1),
        "A is not positive semi-definite: its least eigenvalue is -1",
    ),
    "weighted_dls without damping": (
        lambda: reference.weighted_dls(WIDE, PAIR, 0.0, 1.0, 0.0),
        r"A, B, damping: JᵀBJ \+ A \+ λ²I is singular",
    ),
    "negative damping": (lambda: reference.dls(WIDE, PAIR, -0.1), "damping is -0.1; it must be"),
    "damping not finite": (lambda: reference.dls(WIDE, PAIR, math.nan), "damping is nan"),
    "unknown form": (
        lambda: reference.dls(WIDE, PAIR, 0.1, form="both"),  # pyright: ignore[reportArgumentType]
        "form is 'both'; it must be one of 'dual', 'primal'",
    ),
    "unknown factorization": (
        lambda: reference.dls(WIDE, PAIR, 0.1, factorization="ldl"),  # pyright: ignore[reportArgumentType]
        "factorization is 'ldl'; it must be one of 'cholesky', 'lu', 'qr', 'svd'",
    ),
    "step bound without damping": (
        lambda: reference.step_bound(PAIR, 0.0),
        "damping is 0.0; it must be finite and > 0",
    ),
    "step bound of a matrix": (lambda: reference.step_bound(WIDE, 1.0), r"xdot has shape \(2, 3\)"),
    "threshold": (
        lambda: reference.damping_sigma_min(WIDE, 0.1, 0.0),
        "threshold is 0.0; it must be finite and > 0",
    ),
    "maximum": (lambda: reference.damping_manipulability(WIDE, -0.1, 1.0), "maximum is -0.1"),
    "minimum": (lambda: reference.damping_error(PAIR, -0.1), "minimum is -0.1"),
    "B of an error": (
        lambda: reference.damping_error(PAIR, 0.1, [1.0, 1.0, 1.0]),
        r"B has shape \(3,\); it must be a number, \(2,\) or \(2, 2\)",
    ),
    "two directions lost": (
        lambda: reference.numerically_filtered(np.zeros((2, 3)), PAIR, 0.1),
        "filtering = 0.1 and damping = 0 are too small for this J",
    ),
    "error of sdls": (
        lambda: reference.selectively_damped(WIDE, [1.0]),
        r"error has shape \(1,\); it must be \(2,\)",
    ),
    "limit of sdls": (lambda: reference.selectively_damped(WIDE, PAIR, 0.0), "limit is 0.0"),
    "blocks of sdls": (
        lambda: reference.selectively_damped(WIDE, PAIR, blocks=(1, 2)),
        r"blocks are \(1, 2\); they must be ≥ 1 and add up to the 2 rows of J",
    ),
    "no level": (lambda: reference.prioritized([]), "levels is empty"),
    "a level": (
        lambda: reference.prioritized([(WIDE, PAIR), (WIDE, [1.0])]),
        r"levels\[1\]: xdot has shape \(1,\)",
    ),
    "columns of a level": (
        lambda: reference.prioritized([(WIDE, PAIR), (SINGULAR, PAIR)]),
        r"levels\[1\]: J has 2 columns; it must have 3 as in levels\[0\]",
    ),
    "tolerance of priorities": (
        lambda: reference.prioritized([(WIDE, PAIR)], tolerance=-1.0),
        "tolerance is -1.0",
    ),
    "shape of a limit": (
        lambda: reference.saturated(WIDE, PAIR, [-1.0, -1.0], 1.0),
        r"lower has shape \(2,\); it must be a number or \(3,\)",
    ),
    "limits crossed": (
        lambda: reference.saturated(WIDE, PAIR, -1.0, [1.0, -2.0, 1.0]),
        r"nothing is between lower\[1\] = -1 and upper\[1\] = -2",
    ),
    "a limit is not a number": (
        lambda: reference.saturated(WIDE, PAIR, math.nan, 1.0),
        r"nothing is between lower\[0\] = nan and upper\[0\] = 1",
    ),
    "limits at infinity": (
        lambda: reference.bounded_dls(WIDE, PAIR, math.inf, math.inf, 0.1),
        r"nothing is between lower\[0\] = inf and upper\[0\] = inf",
    ),
    "limits without a solution": (
        lambda: reference.saturated(np.eye(2), [1.0, 0.0], [-1.0, 0.5], 1.0),
        "lower, upper: no v inside them has J v = s xdot",
    ),
    "no damping in a box": (
        lambda: reference.bounded_dls(WIDE, PAIR, -1.0, 1.0, 0.0),
        "damping is 0.0; it must be finite and > 0",
    ),
    "too little damping in a box": (
        lambda: reference.bounded_dls(WIDE, PAIR, -1.0, 1.0, 1e-12),
        r"damping = 1e-12 is too small for this J: at least 2\.65e-08",
    ),
    "limit of clamp": (lambda: reference.clamp(PAIR, 0.0), "limit is 0.0; it must be > 0"),
    "limit of clamp not a number": (lambda: reference.clamp(PAIR, math.nan), "limit is nan"),
    "dx of clamp": (
        lambda: reference.clamp(WIDE, 1.0),
        r"dx has shape \(2, 3\); it must be \(n,\)",
    ),
    "f of descent": (
        lambda: reference.descent(PAIR, PAIR, lambda q: q[:1], lambda q: np.eye(2)),
        r"f\(q\) has shape \(1,\); it must be \(2,\)",
    ),
    "jacobian of descent": (
        lambda: reference.descent(PAIR, 2 * PAIR, lambda q: q, lambda q: WIDE),
        r"jacobian\(q\) has shape \(2, 3\); it must be \(2, 2\)",
    ),
    "tolerance of descent": (
        lambda: reference.descent(PAIR, PAIR, lambda q: q, lambda q: np.eye(2), tolerance=-1.0),
        "tolerance is -1.0",
    ),
    "angles of the planar arm": (
        lambda: planar_2r.forward([0.0, 0.0, 0.0]),
        r"q has shape \(3,\); it must be \(2,\)",
    ),
    "a length of the planar arm": (
        lambda: planar_2r.jacobian(PAIR, (1.0, 0.0)),
        r"lengths\[1\] is 0.0; it must be finite and > 0",
    ),
    "velocity of the planar arm": (
        lambda: planar_2r.velocity(PAIR, [1.0]),
        r"xdot has shape \(1,\); it must be \(2,\)",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_says_what_is_wrong(name) -> None:
    call, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("factorization", ["cholesky", "lu", "qr", "svd"])
@pytest.mark.parametrize(
    ("J", "damping"),
    [(SINGULAR, 0.0), (SINGULAR, 1e-18), (np.ones((6, 6)), 1e-18), (np.zeros((2, 2)), 0.0)],
)
def test_too_little_damping_of_a_singular_jacobian_is_noticed(J, damping, factorization) -> None:
    with pytest.raises(ValueError, match=r"damping = \S+ is too small for this J: JJᵀ \+ λ²I"):
        reference.dls(J, np.ones(len(J)), damping, factorization=factorization)
    with pytest.raises(ValueError, match=r"damping = \S+ is too small for this J: JᵀJ \+ λ²I"):
        reference.dls(J, np.ones(len(J)), damping, "primal", factorization)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("size", [2, 6, 7])
def test_a_jacobian_singular_but_for_rounding_is_noticed(size, seed) -> None:
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(size, size - 1)) @ rng.normal(size=(size - 1, size))
    for call in (
        reference.inverse,
        lambda J, xdot: reference.pinv(J, xdot, form="right"),
        lambda J, xdot: reference.weighted(J, xdot, 1.0),
        lambda J, xdot: reference.dls(J, xdot, 0.0),
    ):
        with pytest.raises(ValueError, match="singular"):
            call(J, np.ones(size))
