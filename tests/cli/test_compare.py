"""`rmrc compare`: its JSON, its page, its exit codes, and what the shipped comparisons show."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from commands import rmrc
from numpy.typing import NDArray

from models import REPOSITORY
from pages import Page, assert_self_contained

CONFIGS = REPOSITORY / "configs"
# What blows up does so by far more than this over what is damped or limited.
BLOWN_UP = 10.0
# The backends solve the same programs to 1e-6 of their gradient; a run of them drifts no further.
SAME_RUN = 1e-3
# Rates of a robot at rest, rad/s, and a run in which it has come to rest for a second, s.
AT_REST, LONG_ENOUGH = 1e-3, 2.0
# Half the steps that the files ask for, of twice the length.
COARSE = ("--set", "dt=0.004")
# How far off the line a hand is that stays on it, and one that is led through the joints, m.
ON_THE_LINE, OFF_THE_LINE = 1e-4, 1e-2


def compared(name: str, folder: Path, *arguments: object) -> dict[str, Any]:
    """Return the JSON of a comparison that went well, its folder as it is given."""
    done = rmrc("compare", CONFIGS / f"{name}.yaml", "--json", *arguments, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout, parse_constant=pytest.fail)


def by_name(numbers: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {run["name"]: run for run in numbers["runs"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("comparisons")


@pytest.fixture(scope="module")
def singular(folder: Path) -> dict[str, Any]:
    methods = "qp, dls,pinv,inverse,weighted"
    return compared("compare_singular", folder, "--methods", methods, *COARSE)


@pytest.fixture(scope="module")
def limits(folder: Path) -> dict[str, Any]:
    return compared("compare_limits", folder, "--methods", "qp,pinv,saturated", *COARSE)


ALSO = ["qp daqp", "qp proxqp", "qp osqp", "dls", "pinv", "inverse"]


def test_the_json_has_a_row_for_each_run_and_a_reason_for_the_others(
    singular: dict[str, Any],
) -> None:
    assert set(singular) == {"comparison", "task", "runs", "left_out", "interrupted"}
    assert singular["task"] == "hand"
    assert singular["interrupted"] is False
    assert list(by_name(singular)) == ["qp native", *ALSO]
    assert [each["name"] for each in singular["left_out"]] == ["weighted"]
    assert "metric" in singular["left_out"][0]["reason"]
    for run in singular["runs"]:
        assert run["finished"]
        assert run["steps"] == run["solves"] == sum(run["status"].values()) == 1501
        assert (run["backend"] is None) == (run["method"] != "qp")
        assert run["follow"] == "rate"
        assert 0.0 < run["error"]["rms"] < run["error"]["max"]
        assert (run["error"]["unit"], run["error"]["orientation"]["unit"]) == ("m", "rad")
        assert run["line"] is None  # waypoints are not a line
        assert run["largest_rate"]["unit"] == "rad/s"
        assert run["largest_rate"]["joint"] in {"joint1", "joint2", "joint3"}
        assert 0.0 <= run["sigma_min"]["value"] < 0.01
        assert 1.5 < run["sigma_min"]["time"] < 3.5
        assert run["step_time_us"]["median"] > 0.0
        assert run["ignored_tasks"] == []


def test_the_folder_holds_the_same_numbers_and_a_page_that_needs_no_network(
    singular: dict[str, Any], folder: Path
) -> None:
    path = folder / singular["comparison"]
    assert singular["comparison"] == str(Path("comparisons") / "compare_singular-0001")
    assert {each.name for each in path.iterdir()} == {"compare.json", "compare.html"}
    kept = json.loads((path / "compare.json").read_text(encoding="utf-8"))
    assert {"comparison": singular["comparison"], **kept["summary"]} == singular
    assert kept["config"]["damping"]["lambda"] == 0.05
    assert kept["versions"]["rmrc"]
    page = Page((path / "compare.html").read_text(encoding="utf-8"))
    assert_self_contained(page)
    for shown in ("qp osqp", "pinv", "LIMITED", "joint2"):
        assert shown in page.texts["td"]
    assert "weighted is left out" in page.texts["li"]


def test_at_a_singularity_what_inverts_blows_up_and_what_is_damped_does_not(
    singular: dict[str, Any],
) -> None:
    runs = by_name(singular)
    rate = {name: run["largest_rate"]["value"] for name, run in runs.items()}
    for name in ("pinv", "inverse"):
        assert rate[name] > BLOWN_UP * rate["dls"]
        assert rate[name] > BLOWN_UP * rate["qp daqp"]
        assert runs[name]["limits"]["velocity"]["max_violation"] > BLOWN_UP
        assert runs[name]["limits"]["velocity"]["joint"] is not None
    for name in ("qp daqp", "qp proxqp", "qp osqp"):
        assert runs[name]["limits"]["velocity"]["max_violation"] == 0.0
        assert runs[name]["error"]["max"] < runs["pinv"]["error"]["max"] / BLOWN_UP


def test_where_the_line_leaves_the_joint_range_closed_forms_leave_it_too(
    limits: dict[str, Any],
) -> None:
    runs = by_name(limits)
    for name in ("qp daqp", "qp proxqp", "qp osqp", "saturated"):
        assert runs[name]["keeps_limits"]
        assert runs[name]["limits"]["position"]["max_violation"] == 0.0
        assert runs[name]["limits"]["velocity"]["max_violation"] == 0.0
    assert not runs["pinv"]["keeps_limits"]
    assert runs["pinv"]["limits"]["position"]["max_violation"] > 0.1
    assert runs["pinv"]["limits"]["position"]["joint"] == "joint4"
    assert runs["pinv"]["error"]["max"] < ON_THE_LINE < runs["qp daqp"]["error"]["max"]
    assert runs["qp daqp"]["error"]["rms"] < runs["saturated"]["error"]["rms"]


def test_the_backends_make_the_same_of_it(limits: dict[str, Any]) -> None:
    runs = by_name(limits)
    for backend in ("proxqp", "osqp"):
        for key in ("rms", "max"):
            expected = pytest.approx(runs["qp daqp"]["error"][key], rel=SAME_RUN)
            assert runs[f"qp {backend}"]["error"][key] == expected


def test_the_three_ways_of_following_a_line(folder: Path) -> None:
    arguments = ("--methods", "qp", "--backends", "daqp", "--follow", "rate,waypoints,joint")
    runs = by_name(compared("compare_line", folder, *arguments))
    assert list(runs) == ["qp rate", "qp waypoints", "qp joint"]
    assert runs["qp rate"]["line"]["max"] < ON_THE_LINE
    assert runs["qp waypoints"]["line"]["max"] < ON_THE_LINE
    assert runs["qp joint"]["line"]["max"] > OFF_THE_LINE
    assert runs["qp joint"]["solves"] < runs["qp rate"]["solves"] < runs["qp waypoints"]["solves"]


def test_the_null_space_keeps_off_the_pillar_and_near_the_middle() -> None:
    from rmrc import compare, load

    config = load(CONFIGS / "compare_redundant.yaml")
    comparison = compare(config, ["qp", "nullspace", "pinv"], ["daqp"])
    entries = {entry.name: entry for entry in comparison.entries}
    assert entries["pinv"].ignored_tasks == ("clearance", "centering")
    distance = {name: least_distance(entry.run.q) for name, entry in entries.items()}
    centering = {n: e.run.summary["tasks"]["centering"]["final"] for n, e in entries.items()}
    for name in ("qp", "nullspace"):
        assert entries[name].ignored_tasks == ()
        assert entries[name].run.summary["tasks"]["hand"]["max"] < ON_THE_LINE
        assert distance[name] > 0.04 > 0.02 > distance["pinv"] > 0.0
        assert centering[name] < 0.75 * centering["pinv"]


def least_distance(q: NDArray[np.float64]) -> float:
    """Return how near the left arm's outer links come to the pillar, m."""
    model = mujoco.MjModel.from_xml_path(str(REPOSITORY / "scenes" / "dual_arm.xml"))
    data, pillar = mujoco.MjData(model), model.geom("obstacle_1").id
    bodies = [model.body(f"left_{name}").id for name in ("link4", "link5", "link6", "gripper")]
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] in bodies]
    least = np.inf
    for row in q[::25]:
        data.qpos = row
        mujoco.mj_kinematics(model, data)
        for geom in geoms:
            apart = mujoco.mj_geomDistance(model, data, geom, pillar, 1.0, np.zeros(6))
            least = min(least, apart)
    return least


def test_out_of_reach_mink_flips_for_ever_and_rmrc_rests(folder: Path) -> None:
    from rmrc import compare, load

    path = CONFIGS / "unreachable.yaml"
    configs = {
        f"curvature={switch}": load(
            path, overrides={"damping.curvature": switch, "duration": LONG_ENOUGH}
        )
        for switch in ("on", "off")
    }
    comparison = compare(configs, ["qp", "mink"], ["daqp"])
    entries = {entry.name: entry for entry in comparison.entries}
    assert list(entries) == ["qp curvature=on", "qp curvature=off", "mink"]
    last = {
        name: np.abs(entry.run.v[entry.run.time > LONG_ENOUGH - 1.0]).max()
        for name, entry in entries.items()
    }
    assert last["qp curvature=on"] < AT_REST
    for name in ("qp curvature=off", "mink"):
        assert last[name] == pytest.approx(2.0, abs=1e-3)
        joint4 = entries[name].run.v[-100:, 3]
        assert (joint4[1:] * joint4[:-1] < 0.0).all()
    mink = entries["mink"].row()
    assert mink["keeps_limits"]
    assert mink["backend"] == "daqp"
    assert mink["ignored_limits"] == mink["ignored_tasks"] == []
    assert mink["limits"]["velocity"]["max_violation"] == 0.0
    assert 0.04 < mink["error"]["final"] < 0.06


def test_values_that_a_method_does_not_read_are_not_run_for_again(folder: Path) -> None:
    arguments = ("--backends", "daqp", "--methods", "qp,dls,pinv,mink", "--set", "duration=0.02")
    sweeps = ("--sweep", "damping.curvature=on,off", "--sweep", "damping.lambda=0.01,0.1")
    numbers = compared("compare_limits", folder, *arguments, *sweeps)
    values = [f"curvature={a} lambda={b}" for a in ("on", "off") for b in ("0.01", "0.1")]
    assert list(by_name(numbers)) == [
        *(f"qp {value}" for value in values),
        *(f"dls {value}" for value in values),
        "pinv",
        "mink curvature=on lambda=0.01",
        "mink curvature=on lambda=0.1",
    ]


def test_by_default_every_method_runs_or_says_why_not(tmp_path: Path) -> None:
    done = rmrc(
        "compare", CONFIGS / "panda_line.yaml", "--set", "duration=0.02", "--out", "c", cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")
    words = done.stdout.split()
    for method in ("daqp", "proxqp", "osqp", "transpose", "pinv", "dls", "sdls"):
        assert method in words
    for method in ("nullspace", "saturated", "descent", "mink"):
        assert method in words
    assert "inverse is left out" in done.stdout
    assert "weighted is left out" in done.stdout
    assert (tmp_path / "c" / "compare.html").is_file()
    again = rmrc("compare", CONFIGS / "panda_line.yaml", "--out", "c", cwd=tmp_path)
    assert again.returncode == 2
    assert "already holds a comparison" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--methods", "qp,pnv"), "no method named 'pnv'; did you mean 'pinv'?"),
        (("--backends", "dqap"), "no QP backend named 'dqap'; did you mean 'daqp'?"),
        (
            ("--follow", "waypoint"),
            "no way of following named 'waypoint'; did you mean 'waypoints'",
        ),
        (("--methods", "inverse,weighted"), "needs as many task rows as dofs"),
        (("--methods", "inverse,weighted"), "needs a metric"),
        (("--set", "duration=never"), "a number is wanted here"),
        (("--sweep", "duration=1,never"), "a number is wanted here"),
        (("--sweep", "duration"), "write it as in --sweep"),
        (("--sweep", "duration="), "write it as in --sweep"),
        (("--sweep", "dt=0.2,0.1", "--methods", "pinv"), "has not the dt"),
        (
            (
                "--methods",
                "mink",
                "--set",
                "tasks=[{name: a, type: smooth}]",
                "--set",
                "targets={}",
            ),
            "mink has no place for any of the tasks",
        ),
        (("--set", "targets.hand={path: file, file: absent.csv}"), "there is no such file"),
    ],
)
def test_wrong_input_is_said_once_and_leaves_nothing(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    done = rmrc("compare", CONFIGS / "compare_limits.yaml", *arguments, "--json", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count(message) == 1
    assert ("needs" in done.stderr) == ("needs" in message)
    assert list(tmp_path.iterdir()) == []
