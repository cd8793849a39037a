"""The record of a run: its folder, the errors of reading one, its summary."""

import json
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from rmrc.cli import main
from rmrc.errors import RmrcError
from rmrc.record import folder as folder_module
from rmrc.record import run as record_run
from rmrc.record.channels import positions, rates
from rmrc.record.form import check_manifest
from rmrc.record.report import write_report
from rmrc.record.run import FORMAT, MANIFEST, REPORT, TRAJECTORY, Run
from rmrc.record.summary import summarize

STATUSES = [
    "OK",
    "LIMITED",
    "SCALED",
    "DAMPED",
    "RECOVERING",
    "RELAXED",
    "STUCK",
    "MAX_ITER",
    "DEADLINE",
    "STALE",
    "INVALID_INPUT",
]
TOLERANCE = {"m": 1e-3, "rad": 1e-2}
SAVERS = 6
"""That save one folder at once."""


def hinge(name: str, address: int, dof: int, half_range: float | None = 2.8) -> dict[str, Any]:
    return {
        "name": name,
        "type": "hinge",
        "qpos": address,
        "dof": dof,
        "unit": "rad",
        "range": None if half_range is None else [-half_range, half_range],
        "velocity": 2.0,
    }


def arm_model() -> dict[str, Any]:
    """Seven hinges, the last without a range."""
    joints = [hinge(f"joint{i + 1}", i, i, None if i == 6 else 2.8 - 0.2 * i) for i in range(7)]
    return {"nq": 7, "nv": 7, "joints": joints}


def humanoid_model() -> dict[str, Any]:
    """A floating base and 37 hinges."""
    base = {"name": "pelvis", "type": "free", "qpos": 0, "dof": 0, "unit": "m", "range": None}
    names = [f"{side}_{part}_joint" for side in ("left", "right") for part in _PARTS]
    names += ["waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"]
    hinges = [hinge(name, 7 + i, 6 + i, 1.0 + 0.05 * i) for i, name in enumerate(names)]
    return {"nq": 44, "nv": 43, "joints": [base | {"velocity": [1.0, 1.0]}, *hinges]}


_PARTS = [
    *("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"),
    *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"),
    *("wrist_roll", "wrist_pitch", "wrist_yaw", "thumb_0", "thumb_1", "thumb_2", "index_0"),
]


def fabricated(
    model: dict[str, Any],
    steps: int = 200,
    dt: float = 0.002,
    name: str = "reach",
    tasks: dict[str, Any] | None = None,
) -> Run:
    """Return a run whose joints swing, whose errors decay, and which has every kind of row."""
    random = np.random.default_rng(0)
    tasks = tasks or {
        "hand": {"type": "frame", "units": ["m", "rad"]},
        "posture": {"type": "posture", "units": ["rad"]},
    }
    time = dt * np.arange(steps, dtype=np.float64)
    v = 1.8 * np.sin(
        2.0 * time[:, None] * random.uniform(0.3, 2.0, model["nv"])
        + random.uniform(0, 6, model["nv"])
    )
    q = np.zeros((steps, model["nq"]))
    for joint in model["joints"]:
        width = 6 if joint["type"] == "free" else 1
        at, dof = joint["qpos"], joint["dof"]
        q[:, at : at + width] = dt * np.cumsum(v[:, dof : dof + width], axis=0)
        if joint["type"] == "free":
            q[:, at + 3 : at + 7] = [1, 0, 0, 0]
        elif joint["range"]:
            q[:, at] = np.clip(q[:, at], *joint["range"])
    decay = np.exp(-3.0 * time)[:, None] + 1e-5
    error = {
        task: np.array([0.4, 0.8, 0.2][: len(what["units"])]) * decay
        for task, what in tasks.items()
    }
    active = np.where(v > 1.75, 1, np.where(v < -1.79, -1, 0)).astype(np.int8)
    status = np.where(active.any(axis=1), 1, 0).astype(np.uint8)
    status[steps // 2 : steps // 2 + steps // 50] = STATUSES.index("RELAXED")
    step_time = random.lognormal(np.log(60e-6), 0.25, steps)
    config = {
        "scene": "../scenes/arm.xml",
        "dt": dt,
        "duration": steps * dt,
        "tolerance": {"position": 1e-3, "orientation": 1e-2},
        "tasks": [{"name": task, "type": what["type"]} for task, what in tasks.items()],
    }
    summary = summarize(
        dt=dt,
        q=q,
        v=v,
        status=status,
        error=error,
        step_time=step_time,
        model=model,
        tasks=tasks,
        statuses=STATUSES,
        engine="python",
        backend="daqp",
        method="qp",
        tolerance=TOLERANCE,
        converging={next(iter(tasks)): (0,)},
        least={},
        resolution=1e-6,
    )
    manifest = {
        "name": name,
        "config": config,
        "config_hash": "0123abcd",
        "root": "configs",
        "versions": {"rmrc": "0.1.0", "mujoco": "4.0.0"},
        "seed": 0,
        "statuses": STATUSES,
        "model": model,
        "tasks": tasks,
        "summary": summary,
    }
    return Run(
        time=time,
        q=q,
        v=v,
        v_measured=v,
        status=status,
        error=error,
        sigma_min=0.1 + 0.09 * np.cos(2 * time),
        active=active,
        kkt=10.0 ** random.uniform(-15, -11, steps),
        step_time=step_time,
        manifest=manifest,
    )


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


# Starts outside


def outside(start: float, *values: float) -> dict[str, Any]:
    """Return what the summary says of the position limits of a rail that ends at 1 m."""
    rail = np.array([start, *values])
    rows = {
        "q": np.stack([rail, 0.0 * rail], axis=1),
        "v": np.zeros((rail.size, 2)),
        "status": np.zeros(rail.size, dtype=np.uint8),
        "error": {"hand": np.zeros((rail.size, 2))},
        "step_time": np.ones(rail.size),
    }
    return summary_of(**rows)["limits"]["position"]


def test_a_joint_that_starts_outside_and_comes_back_passes_no_limit() -> None:
    found = outside(1.2, 1.15, 1.2, 0.9, 0.8)
    assert found["max_violation"] == 0.0
    assert found["started_outside"]["max_violation"] == pytest.approx(0.2)
    assert found["started_outside"]["joint"] == "rail"
    assert outside(0.9, 0.95)["started_outside"] is None


@pytest.mark.parametrize(
    ("way", "by"),
    [
        ((1.2, 1.3, 0.9), 0.3),  # further out than it started
        ((1.2, 0.9, 1.1, 0.9), 0.1),  # out again
        ((1.2, 1.15, 1.1), 0.1),  # not back at the end
    ],
)
def test_what_happens_after_a_start_outside_counts(way: tuple[float, ...], by: float) -> None:
    found = outside(*way)
    assert found["max_violation"] == pytest.approx(by)
    assert found["started_outside"]["max_violation"] == pytest.approx(0.2)


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


# The summary

TWO_JOINTS = {
    "nq": 2,
    "nv": 2,
    "joints": [
        {"name": "rail", "type": "slide", "qpos": 0, "dof": 0, "unit": "m", "range": [0.0, 1.0]}
        | {"velocity": 0.5, "acceleration": 20.0},
        {"name": "swivel", "type": "hinge", "qpos": 1, "dof": 1, "unit": "rad", "range": None}
        | {"velocity": None},
    ],
}


def summary_of(**changes: Any) -> dict[str, Any]:
    """Summarize four steps of 10 ms whose numbers can be worked out by hand."""
    pieces = {
        "dt": 0.01,
        "q": np.array([[0.5, 9.0], [0.9, 9.0], [1.02, 9.0], [0.99, 9.0]]),
        "v": np.array([[0.1, 50.0], [0.5, 50.0], [0.6, 50.0], [0.55, 50.0]]),
        "status": np.array([0, 1, 1, 0], dtype=np.uint8),
        "error": {"hand": np.array([[3.0, 0.3], [4.0, 0.1], [0.0, 0.1], [5e-4, 0.005]])},
        "step_time": np.array([1e-3, 2e-3, 3e-3, 4e-3]),
        "model": TWO_JOINTS,
        "tasks": {"hand": {"type": "frame", "units": ["m", "rad"]}},
        "statuses": STATUSES,
        "engine": "python",
        "backend": "daqp",
        "method": "qp",
        "tolerance": TOLERANCE,
        "least": {},
        "resolution": 1e-6,
        "converging": {"hand": (0, 1)},
    }
    return summarize(**(pieces | changes))


def test_the_summary_is_what_the_arrays_say() -> None:
    summary = summary_of()
    assert summary["steps"] == 4
    assert (summary["engine"], summary["backend"], summary["method"]) == ("python", "daqp", "qp")
    assert summary["converged"] is False  # it has only just arrived
    assert summary["status"] == {"OK": 2, "LIMITED": 2}
    hand = summary["tasks"]["hand"]
    assert hand["rms"] == pytest.approx(np.sqrt((9 + 16 + 0 + 25e-8) / 4))
    assert (hand["max"], hand["final"], hand["unit"]) == (4.0, 5e-4, "m")
    assert hand["orientation"]["rms"] == pytest.approx(np.sqrt((0.11 + 25e-6) / 4))
    assert hand["orientation"]["max"] == 0.3
    assert (hand["orientation"]["final"], hand["orientation"]["unit"]) == (0.005, "rad")
    assert summary["step_time_us"] == pytest.approx({"median": 2500, "p99": 3970, "max": 4000})
    assert summary["real_time_factor"] == pytest.approx(0.04 / 0.01)


def test_violations_are_the_largest_excess_with_its_joint() -> None:
    limits = summary_of()["limits"]
    assert limits["position"] == {
        "max_violation": pytest.approx(0.02),
        "joint": "rail",
        "unit": "m",
        "started_outside": None,
    }
    assert limits["velocity"] == {
        "max_violation": pytest.approx(0.1),
        "joint": "rail",
        "unit": "m/s",
    }
    # 0.1 → 0.5 m/s in 10 ms is 40 m/s², twice the limit.
    assert limits["acceleration"]["max_violation"] == pytest.approx(20.0)
    assert limits["collision"]["max_violation"] == 0


def test_the_first_step_starts_from_rest() -> None:
    v = np.array([[0.3, 0.0], [0.3, 0.0], [0.3, 0.0], [0.3, 0.0]])
    assert summary_of(v=v)["limits"]["acceleration"]["max_violation"] == pytest.approx(10.0)


def test_rounding_is_no_violation() -> None:
    q = np.full((4, 2), 1.0 + 1e-15)
    assert summary_of(q=q)["limits"]["position"]["max_violation"] == 0.0


@pytest.mark.parametrize(
    ("final", "converging", "converged"),
    [
        ([1e-3, 1e-2], {"hand": (0, 1)}, True),
        ([1.1e-3, 0.0], {"hand": (0, 1)}, False),
        ([0.0, 1.1e-2], {"hand": (0, 1)}, False),
        ([0.0, 1.1e-2], {"hand": (0,)}, True),
        ([np.nan, 0.0], {"hand": (0,)}, False),
        ([9.0, 9.0], {}, True),
    ],
)
def test_converged_compares_the_end_of_the_run(
    final: list[float], converging: dict[str, tuple[int, ...]], converged: bool
) -> None:
    error = {"hand": np.vstack([np.full((2, 2), 9.0), np.zeros((9, 2)), final])}
    assert summary_of(error=error, converging=converging)["converged"] is converged


@pytest.mark.parametrize(("dt", "window"), [(0.01, 10), (0.001, 100), (0.1, 10)])
def test_a_run_has_converged_that_stays_within_tolerance(dt: float, window: int) -> None:
    """For the last 0.1 s and 10 steps: one that swings through its target has not."""
    error = np.zeros((200, 2))
    error[-window - 1] = 9.0
    assert summary_of(dt=dt, error={"hand": error})["converged"]
    error[-window] = 9.0
    assert not summary_of(dt=dt, error={"hand": error})["converged"]


def test_a_run_without_steps_has_a_summary() -> None:
    summary = summary_of(
        q=np.empty((0, 2)),
        v=np.empty((0, 2)),
        status=np.empty(0, dtype=np.uint8),
        error={"hand": np.empty((0, 2))},
        step_time=np.empty(0),
    )
    assert (summary["steps"], summary["converged"], summary["status"]) == (0, False, {})
    assert summary["tasks"]["hand"]["final"] is None
    assert summary["step_time_us"]["median"] is None
    assert summary["real_time_factor"] is None


def test_balls_and_free_joints_have_limits_on_what_they_are() -> None:
    half = np.sqrt(0.5)
    ball = {"name": "hip", "type": "ball", "qpos": 7, "dof": 6, "unit": "rad", "range": [0.0, 1.0]}
    free = {"name": "base", "type": "free", "qpos": 0, "dof": 0, "unit": "m", "range": None}
    model = {
        "nq": 11,
        "nv": 9,
        "joints": [free | {"velocity": [1.0, 2.0]}, ball | {"velocity": 3.0}],
    }
    q = np.array([[1.0, 2.0, 3.0, 1, 0, 0, 0, -half, 0, half, 0]])
    # A quarter turn, however its quaternion's sign is chosen, is π/2 − 1 past the limit.
    *_, angle = positions(model, q)
    assert (angle.name, angle.unit) == ("hip angle", "rad")
    assert angle.excess == pytest.approx(np.pi / 2 - 1)
    channels = rates(model, np.arange(9.0)[None], "velocity")
    assert [channel.unit for channel in channels] == ["m/s"] * 3 + ["rad/s"] * 6
    assert [channel.upper for channel in channels] == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert [float(channel.excess[0]) for channel in channels] == [0, 0, 1, 1, 2, 3, 3, 4, 5]
