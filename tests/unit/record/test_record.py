"""The record of a run: its folder, the errors of reading one, its summary."""

import json
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from fabricated_runs import arm_model, fabricated, humanoid_model

from rmrc.errors import RmrcError
from rmrc.record import folder as folder_module
from rmrc.record import run as record_run
from rmrc.record.run import FORMAT, MANIFEST, REPORT, TRAJECTORY, Run

SAVERS = 6
"""That save one folder at once."""


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


@pytest.fixture(scope="module")
def run() -> Run:
    return fabricated(arm_model())


@pytest.fixture
def folder(run: Run, tmp_path: Path) -> Path:
    return run.save(tmp_path / "run", report=False)


# The folder


@pytest.mark.parametrize("model", [arm_model(), humanoid_model()], ids=["arm", "humanoid"])
def test_a_run_saved_loaded_and_saved_again_is_the_same_bytes(
    model: dict[str, Any], tmp_path: Path
) -> None:
    run = fabricated(model)
    run.sigma_min[::3] = np.nan
    run.kkt[0] = np.inf
    Run.load(run.save(tmp_path / "a")).save(tmp_path / "b")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert set(contents(tmp_path / "a")) == {MANIFEST, TRAJECTORY, REPORT}


def test_the_archive_carries_no_dates(folder: Path) -> None:
    with zipfile.ZipFile(folder / TRAJECTORY) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_the_archive_is_an_ordinary_npz(run: Run, folder: Path) -> None:
    with np.load(folder / TRAJECTORY) as archive:
        assert set(archive) == {
            *("time", "q", "v", "v_measured", "status", "sigma_min", "active", "kkt", "step_time"),
            *("error.hand", "error.posture"),
        }
        np.testing.assert_array_equal(archive["error.hand"], run.error["hand"])
        assert archive["status"].dtype == np.uint8
        assert archive["active"].dtype == np.int8


def test_the_manifest_is_strict_json(run: Run, tmp_path: Path) -> None:
    manifest = run.manifest | {
        "seed": np.int64(3),
        "root": Path("a") / "b",
        "summary": {"a": np.nan, "b": (np.float64(1.5), -np.inf), "c": np.arange(2)},
    }
    folder = replace(run, manifest=manifest).save(tmp_path / "run", report=False)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    read = json.loads((folder / MANIFEST).read_text(encoding="utf-8"), parse_constant=refuse)
    assert read["summary"] == {"a": None, "b": [1.5, None], "c": [0, 1]}
    assert (read["seed"], read["root"], read["format"]) == (3, str(Path("a") / "b"), FORMAT)


def test_save_takes_an_empty_folder_and_gives_back_the_path_it_was_given(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    assert run.save("empty", report=False) == Path("empty")
    assert run.save("new/deep", report=False) == Path("new/deep")
    assert Run.load("empty").summary == Run.load("new/deep").summary == run.summary


def test_save_does_not_replace_a_run_unasked(run: Run, folder: Path) -> None:
    before = contents(folder)
    with pytest.raises(RmrcError, match="already holds a run"):
        run.save(folder)
    assert contents(folder) == before


def test_save_replaces_a_run_when_asked(folder: Path) -> None:
    fabricated(arm_model(), steps=5).save(folder, overwrite=True, report=False)
    assert len(Run.load(folder).time) == 5
    assert list(folder.parent.iterdir()) == [folder]


def test_save_never_replaces_what_is_not_a_run(run: Run, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("x")
    (tmp_path / "file").write_text("x")
    for name in ("thesis", "file"):
        with pytest.raises(RmrcError, match="is not a run folder"):
            run.save(tmp_path / name, overwrite=True)
    with pytest.raises(RmrcError, match="cannot save a run"):
        run.save(tmp_path / "file" / "run")
    assert {path.name for path in tmp_path.rglob("*")} == {"thesis", "chapter.tex", "file"}


def failing(mistake: BaseException) -> Callable[..., Any]:
    def fail(*_: Any, **__: Any) -> None:
        raise mistake

    return fail


@pytest.mark.parametrize(
    ("place", "mistake"),
    [
        ("rmrc.record.run.write_report", RuntimeError("report")),
        ("rmrc.record.run.write_report", KeyboardInterrupt()),
        ("rmrc.record.run._write_arrays", MemoryError()),
        ("pathlib.Path.rename", PermissionError("no")),
    ],
)
@pytest.mark.parametrize("there_is_one", [False, True])
def test_a_crash_leaves_the_folder_absent_or_as_it_was(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
    mistake: BaseException,
    there_is_one: bool,
) -> None:
    if there_is_one:
        fabricated(arm_model(), steps=5).save(tmp_path / "run", report=False)
    before = {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
    with monkeypatch.context() as patch:
        patch.setattr(place, failing(mistake))
        with pytest.raises(RmrcError if isinstance(mistake, OSError) else type(mistake)):
            run.save(tmp_path / "run", overwrite=True)
    assert {path.relative_to(tmp_path) for path in tmp_path.rglob("*")} == before
    if there_is_one:
        assert len(Run.load(tmp_path / "run").time) == 5


@pytest.mark.parametrize("failing_call", [2, 3])  # the first finds the old run in its way
def test_a_crash_between_the_two_renamings_puts_the_old_run_back(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, failing_call: int
) -> None:
    before, rename, calls = contents(folder), Path.rename, []

    def fail_once(path: Path, target: Path) -> Path:
        calls.append(path)
        if len(calls) == failing_call:
            raise OSError("disk")
        return rename(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", fail_once)
        with pytest.raises(RmrcError, match="disk"):
            run.save(folder, overwrite=True, report=False)
    assert contents(folder) == before
    assert list(folder.parent.iterdir()) == [folder]


@pytest.mark.parametrize("there_is", ["nothing", "an empty folder"])
def test_of_several_that_save_a_folder_at_once_one_wins(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there_is: str
) -> None:
    if there_is != "nothing":
        (tmp_path / "same").mkdir()
    several = Barrier(SAVERS)
    write_arrays = record_run._write_arrays

    def wait_for_all(path: Path, arrays: dict[str, Any]) -> None:
        several.wait()  # by now each of them has found the folder free
        write_arrays(path, arrays)

    monkeypatch.setattr(record_run, "_write_arrays", wait_for_all)

    def save(seed: int) -> str:
        manifest = run.manifest | {"seed": seed}
        try:
            replace(run, manifest=manifest).save(tmp_path / "same", report=False)
        except RmrcError as mistake:
            return str(mistake)
        return f"saved {seed}"

    with ThreadPoolExecutor(SAVERS) as pool:
        said = list(pool.map(save, range(SAVERS)))
    (saved,) = [text for text in said if text.startswith("saved")]
    assert f"saved {Run.load(tmp_path / 'same').manifest['seed']}" == saved
    assert sum("already holds a run" in text for text in said) == SAVERS - 1
    assert list(tmp_path.iterdir()) == [tmp_path / "same"]


def test_a_run_is_shown_in_one_line(run: Run) -> None:
    assert repr(run) == "<Run 'reach' of 200 steps>"


# Numbered folders


def test_numbers_count_up_from_the_highest(run: Run, tmp_path: Path) -> None:
    for name in ("reach-0003", "reach-0007-old", "other-0009", "reach-12"):
        (tmp_path / name).mkdir()
    saved = [run.save_numbered(tmp_path, report=False) for _ in range(2)]
    assert saved == [tmp_path / "reach-0004", tmp_path / "reach-0005"]
    assert len(Run.load(saved[1]).time) == len(run.time)
    (tmp_path / "reach-9999").mkdir()
    assert run.save_numbered(tmp_path, report=False).name == "reach-10000"


def test_a_name_cannot_leave_the_parent_folder(run: Run, tmp_path: Path) -> None:
    named = replace(run, manifest=run.manifest | {"name": "../a b/é"})
    assert named.save_numbered(tmp_path / "runs", report=False) == tmp_path / "runs/.._a_b_é-0001"


def test_a_number_taken_meanwhile_is_passed_over(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run.save_numbered(tmp_path, report=False)
    before = contents(first)
    monkeypatch.setattr(folder_module, "_last_number", lambda *_: 0)
    second = fabricated(arm_model(), steps=5).save_numbered(tmp_path, report=False)
    assert (first.name, second.name) == ("reach-0001", "reach-0002")
    assert contents(first) == before


def test_saving_at_once_gives_every_run_its_own_number(tmp_path: Path) -> None:
    runs = [fabricated(arm_model(), steps=steps) for steps in range(1, 17)]
    with ThreadPoolExecutor(8) as pool:
        saved = list(pool.map(lambda run: run.save_numbered(tmp_path, report=False), runs))
    assert sorted(path.name for path in saved) == [f"reach-{i:04d}" for i in range(1, 17)]
    assert [len(Run.load(path).time) for path in saved] == [len(run.time) for run in runs]
    assert sorted(tmp_path.iterdir()) == sorted(saved)
