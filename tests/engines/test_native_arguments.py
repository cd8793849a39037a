"""The extension's own classes refuse what does not fit: an exception, never a crash.

`tests/fuzzing/arguments.py` changes every argument there is, under the sanitizers.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import config
from rmrc.control.fast.batch import NativeBatch

_native = pytest.importorskip(
    "rmrc._native", reason="the native extension is not built", exc_type=ImportError
)


def problem(repository: Path, scene: str = "dual_arm", **limits: Any) -> rmrc.Problem:
    frame = {"dual_arm": "left_hand", "panda": "hand", "ur5e": "tool"}[scene]
    task = {"name": "hand", "type": "frame", "frame": {"site": frame}}
    return rmrc.compile(config(str(repository / "scenes" / f"{scene}.xml"), [task], limits=limits))


@contextmanager
def changed(monkeypatch: pytest.MonkeyPatch, name: str, **arguments: Any) -> Iterator[None]:
    """Have a class of the extension called with other arguments; a function takes the old one."""
    made = getattr(_native, name)

    def call(*args: Any, **given: Any) -> Any:
        for key, value in arguments.items():
            given[key] = value(given[key]) if callable(value) else value
        return made(*args, **given)

    with monkeypatch.context() as patch:
        patch.setattr(_native, name, call)
        yield


@pytest.mark.parametrize(
    "sizes",
    [(0,), (-1,), (2**31 - 1,), (50_000,), (7, 2**31 - 1), (7, -1), (7, 1, -1), (7, 1, 1, 0)],
)
def test_sizes_of_a_solver(sizes: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="out of range"):
        _native.QPSolver(*sizes)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("Engine", {"dofs": lambda dofs: [*dofs[:-1], 99]}),
        ("Engine", {"dofs": lambda dofs: [-1, *dofs[1:]]}),
        ("Engine", {"dofs": lambda dofs: dofs[::-1]}),
        ("Engine", {"jacobian": lambda J: J[:-1]}),
        ("Engine", {"error": lambda e: e.astype(np.float32)}),
        ("Engine", {"H": lambda H: H.T[:-1]}),
        ("Engine", {"limits": lambda limits: ([999] * len(limits[0]), *limits[1:])}),
        ("Engine", {"limits": lambda limits: (*limits[:5], [0.0] * 14, *limits[6:])}),
        ("Engine", {"model": None}),
        ("Engine", {"data": lambda data: object()}),
        ("Engine", {"max_iter": 0}),
        ("TermRows", {"first": 2**31 - 1}),
        ("TermRows", {"first": -1}),
        ("TermRows", {"target": np.zeros(2)}),
        ("TermRows", {"clamps": [(2**31 - 1, 1, 0.1)]}),
        ("Rows", {"lower": lambda lower: lower[:-1]}),
        ("Rows", {"ids": lambda ids: ids.astype(np.int32)}),
        ("Shortening", {"twist": np.zeros(7)}),
        ("ForwardKinematics", {"bodies": lambda bodies: [(9999, *bodies[0][1:]), *bodies[1:]]}),
        ("Stepper", {"quaternions": [2**31 - 1]}),
        ("Stepper", {"watched": [(7, [1.0], 0.1, 0.1)]}),
        ("Stepper", {"q": lambda q: q[:-1]}),
    ],
)
def test_arguments_that_do_not_fit(
    repository: Path, monkeypatch: pytest.MonkeyPatch, name: str, arguments: dict[str, Any]
) -> None:
    given = problem(repository, collision={"pairs": "all"}, acceleration={"default": 10.0})
    with (
        changed(monkeypatch, name, **arguments),
        pytest.raises((ValueError, TypeError, RuntimeError)),
    ):
        rmrc.Controller(given, engine="native")


def test_pairs_of_geoms_that_are_not_there(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rmrc.limits.collision import Collision

    arrays = Collision.arrays
    monkeypatch.setattr(Collision, "arrays", lambda self: arrays(self) | {"geoms": wild(self)})

    def wild(barrier: Any) -> np.ndarray:
        return np.full_like(arrays(barrier)["geoms"], 2**40)

    with pytest.raises(ValueError, match="geom"):
        rmrc.Controller(problem(repository, collision={"pairs": "all"}), engine="native")


def test_rows_of_another_engine(repository: Path) -> None:
    one, other = (
        rmrc.Controller(problem(repository, collision={"pairs": "all"}), engine="native")
        for _ in range(2)
    )
    engines: list[Any] = [each.engine for each in (one, other)]
    with pytest.raises(ValueError, match="another engine's"):
        engines[0]._native.limit(engines[1]._rows.native, None)
    with pytest.raises(ValueError, match="in use"):
        engines[0]._rows.native.add_balls([], 0.9, 0.1)


def test_a_batch_of_two_problems(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(_native, "Batch", lambda **given: given)
        made: list[Any] = [
            rmrc.BatchController(problem(repository, scene), 2, threads=1, engine="native")
            for scene in ("panda", "ur5e")
            if not patch.setattr("rmrc.control.fast.batch.NativeBatch.reset", lambda *_: None)
        ]
    one, other = (each._elements._native for each in made)
    for workers in (one["workers"] + other["workers"], one["workers"] * 2):
        with pytest.raises(ValueError, match=r"wrong size|one problem"):
            _native.Batch(count=2, workers=workers, start=one["start"])
    with pytest.raises(ValueError, match="out of range"):
        _native.Batch(count=2**31 - 1, workers=one["workers"], start=one["start"])


def test_a_controller_outlives_its_batch(repository: Path) -> None:
    """What its collision limits remember stands in the batch's memory for as long as that is."""
    given = problem(repository, collision={"pairs": "all"})
    first, alone = (rmrc.Controller(given, engine="native") for _ in range(2))
    batch = NativeBatch(given, [first], 3)
    batch.step(None, given.dt)
    del batch
    first.reset()
    for _ in range(5):
        assert (first.step().v == alone.step().v).all()
