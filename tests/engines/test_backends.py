"""Every backend against an independent solver and its own fresh start, and where it must fail."""

import numpy as np
import pytest
from backend_programs import (
    BUILDERS,
    ILL_CONDITIONED,
    KINDS,
    KKT_TOLERANCE,
    OBJECTIVE_TOLERANCE,
    SAME_VELOCITY,
    objective,
    programs,
)
from programs import copy_into, moving_program, random_qp, solved

from rmrc.errors import SolverError
from rmrc.qp.backends import BACKENDS, Backend, create
from rmrc.qp.certificate import Certificate
from rmrc.qp.polish import Polish
from rmrc.qp.program import QP, UNCERTIFIED, Solution, SolveStatus

FIRST_ORDER = ("proxqp", "osqp")


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


@pytest.mark.parametrize("with_rows", [False, True], ids=["box", "rows"])
def test_random_programs_are_solved_as_an_independent_solver_does(
    backend: Backend, with_rows: bool
) -> None:
    for qp, least in programs(with_rows):
        solution = solved(backend, qp)
        assert solution.status is SolveStatus.SOLVED
        assert solution.kkt.largest <= KKT_TOLERANCE
        assert (qp.lb <= solution.v).all()
        assert (solution.v <= qp.ub).all()
        difference = abs(objective(qp, solution.v) - least)
        assert difference <= OBJECTIVE_TOLERANCE * max(1.0, abs(least))


def test_the_random_programs_cover_what_is_hard() -> None:
    for with_rows in (False, True):
        pairs = [(qp, solved(create("daqp"), qp)) for qp, _ in programs(with_rows)]
        at_bound = [np.isclose(s.v, qp.lb) | np.isclose(s.v, qp.ub) for qp, s in pairs]
        pushed = [s.bound_multiplier != 0.0 for _, s in pairs]
        assert {qp.g.size for qp, _ in pairs} >= {1, 6, 7, 43}
        assert any(at.size == 43 and at.all() for at in at_bound) or with_rows
        assert any((at & ~z).any() for at, z in zip(at_bound, pushed, strict=True))  # weakly active
        assert (
            sum(not s.bound_multiplier.any() and not s.row_multiplier.any() for _, s in pairs) > 20
        )
        assert sum((qp.lb == qp.ub).any() for qp, _ in pairs) > 50
        assert sum(np.isinf(qp.lb).any() for qp, _ in pairs) > 50
    assert sum(qp.f.size > 0 for qp, _ in pairs) > 50
    assert sum(np.count_nonzero(s.row_multiplier) > 1 for _, s in pairs) > 50
    twice = [(qp.C[: qp.lo.size // 4] @ s.v, qp) for qp, s in pairs if qp.lo.size >= 4]
    active = [
        np.isclose(rows, qp.lo[: rows.size]) | np.isclose(rows, qp.hi[: rows.size])
        for rows, qp in twice
    ]
    assert sum(rows.any() for rows in active) > 50


@pytest.mark.parametrize(("n", "rows"), [(1, 0), (6, 3), (7, 0), (7, 8), (43, 10)])
def test_an_update_in_place_equals_a_fresh_solve(backend: Backend, n: int, rows: int) -> None:
    rng = np.random.default_rng(3)
    for k, qp in enumerate(moving_program(rng, n, rows, steps=30)):
        if k == 0:
            backend.setup(qp)
        else:
            backend.update(qp)
        warm = backend.solve()
        certificate = Certificate(qp)
        assert warm.status is SolveStatus.SOLVED
        assert certificate.certify(warm) <= KKT_TOLERANCE
        fresh = solved(create("daqp"), qp)
        np.testing.assert_allclose(warm.v, fresh.v, rtol=0.0, atol=SAME_VELOCITY)


def test_an_update_to_an_unrelated_program_equals_a_fresh_solve(backend: Backend) -> None:
    rng = np.random.default_rng(14)
    for n, rows in ((1, 0), (7, 0), (7, 3), (20, 3)):
        qp = random_qp(rng, n, "plain", rows)
        backend.setup(qp)
        for scale in (1.0, 1e-3, 1e3, 1.0):
            backend.solve()
            other = random_qp(rng, n, "plain", rows)
            copy_into(qp, other)
            qp.H[:], qp.g[:] = scale * (qp.H + np.eye(n)), scale * qp.g
            backend.update(qp)
            solution = backend.solve()
            assert solution.status is SolveStatus.SOLVED
            assert Certificate(qp).certify(solution) <= KKT_TOLERANCE * max(1.0, scale)
            fresh = solved(create("daqp"), qp)
            np.testing.assert_allclose(solution.v, fresh.v, rtol=0.0, atol=SAME_VELOCITY)


def test_the_same_sequence_gives_the_same_bits(backend: Backend) -> None:
    def run() -> list[bytes]:
        rng, found = np.random.default_rng(4), []
        for k, qp in enumerate(moving_program(rng, 7, 3, steps=20)):
            backend.update(qp) if k else backend.setup(qp)
            solution = backend.solve()
            found += [solution.v.tobytes(), solution.row_multiplier.tobytes()]
        return found

    assert run() == run()


def test_a_solution_is_not_overwritten_by_the_next(backend: Backend) -> None:
    qp = random_qp(np.random.default_rng(5), 7, rows=2)
    first = solved(backend, qp)
    kept = [first.v.copy(), first.bound_multiplier.copy(), first.row_multiplier.copy()]
    qp.g[:] = -qp.g
    backend.update(qp)
    second = backend.solve()
    assert not np.array_equal(second.v, first.v)
    for before, after in zip(
        kept, [first.v, first.bound_multiplier, first.row_multiplier], strict=True
    ):
        np.testing.assert_array_equal(before, after)


def test_a_second_identical_solve_takes_no_more_iterations(backend: Backend) -> None:
    for qp, _ in programs(True)[:60]:
        backend.setup(qp)
        first = backend.solve()
        backend.update(qp)
        assert backend.solve().iterations <= first.iterations


def test_warm_starts_save_iterations() -> None:
    # Else "no more iterations" would also hold of a backend that starts cold every time.
    for name in BACKENDS:
        backend, cold, warm = create(name), 0, 0
        for qp, _ in programs(True)[:60]:
            backend.setup(qp)
            cold += backend.solve().iterations
            backend.update(qp)
            warm += backend.solve().iterations
        assert warm < cold, name


@pytest.mark.parametrize("size", [1, 7])
def test_another_program_needs_no_setup_call(backend: Backend, size: int) -> None:
    backend.setup(random_qp(np.random.default_rng(6), 6, rows=2))
    backend.solve()
    other = random_qp(np.random.default_rng(7), size)
    backend.update(other)
    solution = backend.solve()
    assert Certificate(other).certify(solution) <= KKT_TOLERANCE


def test_a_solve_before_setup_is_refused(backend: Backend) -> None:
    with pytest.raises(SolverError, match="setup"):
        backend.solve()


@pytest.mark.parametrize(
    ("condition", "tolerance"), [(1e8, KKT_TOLERANCE), (1e10, ILL_CONDITIONED)]
)
def test_an_ill_conditioned_hessian_is_solved(
    backend: Backend, condition: float, tolerance: float
) -> None:
    rng = np.random.default_rng(10)
    for n in (6, 7, 20, 43):
        for _ in range(10):
            qp = random_qp(rng, n, "plain", rows=n // 3)
            qp.H[:] = 0.0
            basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
            qp.H[:] = (basis * np.geomspace(1.0, 1.0 / condition, n)) @ basis.T
            qp.H[:] = 0.5 * (qp.H + qp.H.T)
            solution = solved(backend, qp)
            assert solution.status is SolveStatus.SOLVED
            assert solution.kkt.largest <= tolerance


def test_a_polished_solution_is_never_worse() -> None:
    rng = np.random.default_rng(12)
    for qp, _ in programs(True)[:100]:
        rough = Solution.at_rest(qp, SolveStatus.MAX_ITER)
        for part in (rough.v, rough.bound_multiplier, rough.row_multiplier):
            part[:] = rng.normal(size=part.size)
        before = Certificate(qp).certify(rough)
        better = Polish(qp).improve(rough)
        assert better.kkt.largest <= before
        optimal = better.kkt.largest <= KKT_TOLERANCE
        assert (better.status is SolveStatus.SOLVED) >= optimal
        if better.status is SolveStatus.SOLVED:
            assert better.kkt.largest <= KKT_TOLERANCE * max(1.0, np.abs(qp.g).max())


def test_a_polished_solution_does_not_depend_on_the_way_to_it() -> None:
    for qp, _ in programs(False)[:: len(KINDS)]:  # plain boxes: nothing is active by a hair
        polish, exact = Polish(qp), solved(create("daqp"), qp)
        other = solved(create("daqp"), qp)
        other.v *= 1.0 + 1e-13
        assert polish.improve(exact).v.tobytes() == polish.improve(other).v.tobytes()


@pytest.mark.parametrize("name", FIRST_ORDER)
def test_polishing_is_what_makes_a_coarse_tolerance_do(name: str) -> None:
    coarse, bare = 0.0, 0.0
    for qp, _ in programs(True)[:60]:
        backend = create(name, tolerance=1e-4)
        coarse = max(coarse, solved(backend, qp).kkt.largest)
        bare = max(bare, Certificate(qp).certify(backend._run(qp, np.inf)))
    assert bare > 1e-5
    assert coarse <= KKT_TOLERANCE


# The program itself.


def test_a_new_program_has_its_buffers_and_no_limits() -> None:
    qp = QP(3, rows=2, equalities=1)
    shapes = {"H": (3, 3), "g": (3,), "lb": (3,), "ub": (3,), "C": (2, 3), "lo": (2,), "hi": (2,)}
    for name, shape in {**shapes, "E": (1, 3), "f": (1,)}.items():
        buffer = getattr(qp, name)
        assert (buffer.shape, buffer.dtype) == (shape, np.float64)
        assert buffer.flags.c_contiguous
    assert np.isneginf([*qp.lb, *qp.lo]).all()
    assert np.isposinf([*qp.ub, *qp.hi]).all()
    assert qp.defect() is None
    assert not hasattr(qp, "__dict__")


@pytest.mark.parametrize("status", SolveStatus)
def test_every_status_has_a_sentence(status: SolveStatus) -> None:
    assert status.message.endswith(".")
    assert status.message.count(".") == 1


def test_the_answer_where_there_is_none_is_at_rest_and_not_certified() -> None:
    solution = Solution.at_rest(QP(3, rows=2, equalities=1))
    assert solution.status is SolveStatus.FAILED
    assert solution.kkt is UNCERTIFIED
    parts = (solution.v, solution.bound_multiplier, solution.row_multiplier)
    assert [part.tolist() for part in parts] == [[0.0] * 3, [0.0] * 3, [0.0] * 2]
