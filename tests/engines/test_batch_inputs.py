"""What is wrong with one element of a batch, or with the arguments of all."""

from typing import Any

import numpy as np
import pytest
from batches import native, panda, scattered

import rmrc
from rmrc import BatchController, Status

INVALID = 1 << Status.INVALID_INPUT


ENGINES = pytest.mark.parametrize("engine", [pytest.param("native", marks=native), "python"])


@ENGINES
def test_one_bad_row_is_no_other_elements_affair(engine: Any) -> None:
    problem = panda(limits={"acceleration": {"default": 2.0}})
    batch, good = (BatchController(problem, 100, engine=engine) for _ in range(2))
    rng = np.random.default_rng(0)
    targets = scattered(problem, 100, rng, 0.2)["hand"]
    targets[6::7, 3:] = [0, 1, 0, 0]
    for each in (batch, good):
        assert each.set_targets("hand", targets).all()
        for _ in range(10):
            each.step()
    q = good.q
    bad = q.copy()
    bad[37, 2] = np.nan
    step, expected = batch.step(bad), good.step(q)
    assert (step.status == Status.INVALID_INPUT).nonzero()[0].tolist() == [37]
    others = np.arange(100) != 37
    np.testing.assert_array_equal(step.v[others], expected.v[others])
    assert np.isfinite(step.v).all()
    assert batch.failures.tolist() == np.eye(100, dtype=int)[37].tolist()
    before, slower = np.abs(expected.v[37]).max(), np.abs(step.v[37]).max()
    assert 0.0 < slower < before  # it brakes at the limit of its acceleration
    assert batch.step().status[37] != Status.INVALID_INPUT


@ENGINES
def test_a_bad_target_keeps_the_last_good_one(engine: Any) -> None:
    problem = panda()
    batch, good = (BatchController(problem, 5, engine=engine) for _ in range(2))
    targets = scattered(problem, 5, np.random.default_rng(0), 0.2)["hand"]
    for each in (batch, good):
        assert each.set_targets("hand", targets).all()
    bad = targets + 0.1
    bad[1, 0], bad[3, 3:] = np.nan, 0.0
    assert batch.set_targets("hand", bad).tolist() == [True, False, True, False, True]
    mixed = np.where([[True], [False], [True], [False], [True]], bad, targets)
    assert good.set_targets("hand", mixed).all()
    step, expected = batch.step(), good.step()
    np.testing.assert_array_equal(step.v, expected.v)
    assert (step.flags ^ expected.flags).tolist() == [0, INVALID, 0, INVALID, 0]
    assert batch.step().flags.tolist() == good.step().flags.tolist()


@ENGINES
def test_what_is_no_input_brakes_all(engine: Any) -> None:
    batch = BatchController(panda(), 3, engine=engine)
    assert batch.set_targets("hand", [[0.4, 0.1, 0.5, 0, 1, 0, 0]] * 3).all()
    moved = batch.step()
    assert (moved.v != 0.0).any(axis=1).all()
    for q, dt in ((moved.q[:2], None), ("q", None), (None, -1.0), (None, "soon"), (moved.q, 1e9)):
        step = batch.step(q, dt)  # type: ignore[arg-type]
        assert step.flags.tolist() == [INVALID] * 3
        np.testing.assert_array_equal(step.q, moved.q)
    for targets, rates in (([0.4, 0.1, 0.5], None), ("home", None), (np.ones((3, 7)), [1.0])):
        assert not batch.set_targets("hand", targets, rates).any()  # type: ignore[arg-type]
    assert (batch.step().flags & INVALID).all()
    assert not (batch.step().flags & INVALID).any()


@ENGINES
def test_rows_may_lie_as_they_like(engine: Any) -> None:
    problem = panda()
    batch, plain = (BatchController(problem, 4, engine=engine) for _ in range(2))
    targets = np.round(scattered(problem, 4, np.random.default_rng(0), 0.2)["hand"], 4)
    assert plain.set_targets("hand", targets).all()
    assert batch.set_targets("hand", np.asfortranarray(targets)).all()
    q = plain.q.astype(np.float32)
    for row in (q.astype(float), q, np.repeat(q, 2, axis=0)[::2], q.tolist()):
        np.testing.assert_array_equal(batch.step(row).v, plain.step(q.astype(float)).v)


def test_a_reset_starts_where_it_is_told() -> None:
    problem, rng = panda(), np.random.default_rng(0)
    batch = BatchController(problem, 4)
    np.testing.assert_array_equal(batch.q, np.tile(problem.start, (4, 1)))
    q = problem.start + 0.1 * rng.normal(size=(4, 7))
    batch.step(dt=-1.0)
    batch.reset(q, v=0.1 * np.ones(7))
    np.testing.assert_array_equal(batch.q, q)
    assert not batch.failures.any()
    step = batch.step(np.full((4, 7), np.nan))
    np.testing.assert_array_equal(step.v, np.zeros((4, 7)))  # no acceleration limit: at once
    q[2, 3] = np.inf
    for bad in (q, q[0, :3], q[2]):
        with pytest.raises(rmrc.ModelError, match="q must be"):
            batch.reset(bad)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: BatchController(panda(), 0), "n must be at least 1, not 0"),
        (lambda: BatchController(panda(), 2, threads=0), "threads must be at least 1, not 0"),
        (lambda: BatchController(panda(), 2, engine="quick"), "no engine named 'quick'"),  # type: ignore[arg-type]
        (lambda: BatchController(panda(), 2).set_targets("hnad", []), "did you mean 'hand'"),
        (
            lambda: BatchController(panda(), 2).set_targets("posture", []),
            "no target that is a pose or",
        ),
    ],
)
def test_mistakes_are_told(call: Any, message: str) -> None:
    with pytest.raises(rmrc.ModelError, match=message):
        call()
