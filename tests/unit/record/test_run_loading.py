"""What loading says of a run folder that is damaged."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fabricated_runs import arm_model, fabricated, hinge

from rmrc.cli import main
from rmrc.errors import RmrcError
from rmrc.record.form import check_manifest
from rmrc.record.report import write_report
from rmrc.record.run import MANIFEST, TRAJECTORY, Run


@pytest.fixture(scope="module")
def run() -> Run:
    return fabricated(arm_model())


@pytest.fixture
def folder(run: Run, tmp_path: Path) -> Path:
    return run.save(tmp_path / "run", report=False)


# Damaged folders


def edited(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        change(manifest)
        (folder / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")

    return damage


def rearranged(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        with np.load(folder / TRAJECTORY) as archive:
            arrays = dict(archive)
        change(arrays)
        np.savez(folder / TRAJECTORY, **arrays)

    return damage


def written(name: str, content: bytes) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_bytes(content)

    return damage


def truncated(folder: Path) -> None:
    content = (folder / TRAJECTORY).read_bytes()
    (folder / TRAJECTORY).write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / MANIFEST).unlink(), "is not a run folder: there is no run.json"),
        (lambda folder: (folder / TRAJECTORY).unlink(), "there is no trajectory.npz in it"),
        (written(MANIFEST, b'{"format": 1,'), r"run.json' is damaged: .*line 1 column"),
        (written(MANIFEST, b"\xff\xfe"), r"run.json' is damaged"),
        (written(MANIFEST, b"[1]"), "is not a run's manifest"),
        (edited(lambda m: m.update(format=2)), "has format 2, and this version reads format 1"),
        (edited(lambda m: m.pop("tasks")), "damaged: tasks: the key 'tasks' is missing"),
        (edited(lambda m: m.update(model=[])), r"run.json' is damaged"),
        (
            edited(lambda m: m.update(statuses=["OK"])),
            "'status' has the value 5, which has no name",
        ),
        (written(TRAJECTORY, b"not a zip file"), "trajectory.npz' is damaged"),
        (written(TRAJECTORY, b""), "trajectory.npz' is damaged"),
        (truncated, "trajectory.npz' is damaged"),
        (rearranged(lambda a: a.pop("kkt")), "has no array 'kkt'"),
        (rearranged(lambda a: a.pop("error.hand")), "there is no array 'error.hand'"),
        (
            rearranged(lambda a: a.update(q=a["q"][:-1])),
            r"'q' has the shape \(199, 7\), and \(200, 7",
        ),
        (rearranged(lambda a: a.update(time=a["time"][1:])), r"'q' has the shape"),
        (rearranged(lambda a: a.update(time=a["time"] % 0.1)), "'time' does not rise after row 49"),
        (
            edited(lambda m: m["model"]["joints"][2].update(qpos="1")),
            r"run.json' is damaged: model.joints\[2\].qpos: .* not the text '1'",
        ),
        (
            edited(lambda m: m["model"]["joints"][2].update(qpos=7)),
            r"model.joints\[2\].qpos: 7 leaves no place for a hinge joint among 7",
        ),
        (edited(lambda m: m["summary"].update(steps=3)), "200 rows, and summary.steps is 3"),
        (rearranged(lambda a: a.update(v=a["q"][:, :3])), r"'v' has the shape \(200, 3\)"),
        (rearranged(lambda a: a.update(kkt=np.array(["x"] * 200))), "'kkt' holds <U1, not numbers"),
        (rearranged(lambda a: a.update(kkt=np.array([{}] * 200))), "trajectory.npz' is damaged"),
    ],
)
def test_loading_says_what_is_wrong(
    folder: Path, damage: Callable[[Path], None], message: str
) -> None:
    damage(folder)
    with pytest.raises(RmrcError, match=message):
        Run.load(folder)


def places(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the place of each value below a value."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in items:
        yield (*place, key)
        if isinstance(item, (dict, list)):
            yield from places(item, (*place, key))


def changed(manifest: dict[str, Any], place: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """Return a manifest with another value at a place, or none for `...`."""
    new = json.loads(json.dumps(manifest))
    *way, last = place
    above: Any = new
    for key in way:
        above = above[key]
    if value is ...:
        del above[last]
    else:
        above[last] = value
    return new


@pytest.mark.parametrize("wrong", [..., None, "x", [1], {"a": []}, -5, 1.5, True], ids=repr)
def test_a_manifest_with_a_wrong_value_anywhere_is_refused_or_still_makes_a_report(
    wrong: Any, tmp_path: Path
) -> None:
    run = fabricated({"nq": 1, "nv": 1, "joints": [hinge("joint1", 0, 0)]}, steps=20)
    said = []
    for place in places(run.manifest):
        manifest = changed(run.manifest, place, wrong)
        try:
            check_manifest(manifest)
            another = replace(run, manifest=manifest)
        except RmrcError as mistake:
            said.append((str(mistake), {str(key) for key in place}))
        else:
            write_report(another, tmp_path / "report.html")
    assert len(said) > 20
    assert all(any(key in mistake for key in keys) for mistake, keys in said)


@pytest.mark.parametrize("name", ["time", "q", "v", "step_time"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_in_a_trajectory_is_named(
    folder: Path, name: str, value: float, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    rearranged(lambda a: a[name].__setitem__((3, ...), value))(folder)
    monkeypatch.setattr("sys.argv", ["rmrc", "report", str(folder)])
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == 2
    assert f"array '{name}' is not finite in row 3" in capsys.readouterr().err


def test_loading_what_is_no_folder_says_so(tmp_path: Path) -> None:
    with pytest.raises(RmrcError, match="nowhere' is not a run folder"):
        Run.load(tmp_path / "nowhere")


def test_a_flipped_byte_is_found_or_harmless(run: Run, folder: Path) -> None:
    content = (folder / TRAJECTORY).read_bytes()
    random = np.random.default_rng(0)
    found = 0
    for at in random.integers(0, len(content), 200):
        damaged = bytearray(content)
        damaged[at] ^= 0x55
        (folder / TRAJECTORY).write_bytes(damaged)
        try:
            loaded = Run.load(folder)
        except RmrcError:
            found += 1
        else:
            np.testing.assert_array_equal(loaded.q, run.q)
    assert found > 100


def test_arrays_that_do_not_fit_are_refused_when_the_run_is_made(run: Run) -> None:
    with pytest.raises(RmrcError, match="'v' has the shape"):
        replace(run, v=run.v[:, :-1])
    with pytest.raises(RmrcError, match=r"there is no array 'error\.hand'"):
        replace(run, error={})
