"""Every shipped configuration runs, converges if it can, keeps its limits, and leaves a folder."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import rmrc as command

import rmrc
from models import REPOSITORY

CONFIGS = sorted((REPOSITORY / "configs").glob("*.yaml"))
SHIPPED = {
    "planar_line",
    "panda_reach",
    "panda_line",
    "panda_circle",
    "ur5e_waypoints",
    "dual_arm_handover",
    "mobile_arm_reach",
    "biped_balance",
    "menagerie_panda",
    "menagerie_g1",
    "menagerie_shadow",
    "four_bar",
    "dual_arm_collision",
    "panda_obstacle",
    "panda_actuated",
    "compare_singular",
    "compare_redundant",
    "compare_limits",
    "compare_line",
    "unreachable",
}
# Their targets leave what the robot can reach, for a while.
BY_DESIGN = {
    "compare_limits": {"STUCK"},
    "compare_singular": {"STUCK"},
    "dual_arm_collision": {"STUCK"},
    "panda_obstacle": {"STUCK", "RELAXED"},  # the ball is faster than the arm can give way
    "unreachable": {"STUCK"},
}
# Their targets stay out of reach: the run ends at rest, and not converged.
NEVER_THERE = {"unreachable"}


def test_every_promised_config_is_there() -> None:
    assert {path.stem for path in CONFIGS} >= SHIPPED


@pytest.fixture(params=CONFIGS, ids=lambda path: path.stem)
def config_path(request: pytest.FixtureRequest) -> Path:
    if "menagerie:" in request.param.read_text():
        request.getfixturevalue("menagerie")
    return request.param


def test_it_solves_on_the_command_line(config_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    done = command("solve", config_path, "--out", out, "--json", cwd=tmp_path)
    there = config_path.stem not in NEVER_THERE
    assert done.returncode == (0 if there else 1), done.stdout + done.stderr
    assert done.stderr == ""
    summary = json.loads(done.stdout)
    assert summary["converged"] == there
    assert all(limit["max_violation"] == 0 for limit in summary["limits"].values())
    assert {path.name for path in out.iterdir()} == {"run.json", "trajectory.npz", "report.html"}
    run = rmrc.Run.load(out)
    assert len(run.time) == summary["steps"]
    assert np.isfinite(run.v).all()
    assert run.kkt.max() < 1e-6
    assert set(summary["status"]) <= {"OK", "LIMITED"} | BY_DESIGN.get(config_path.stem, set())


def test_the_same_config_gives_the_same_arrays_bit_for_bit() -> None:
    path = REPOSITORY / "configs" / "panda_line.yaml"
    first, second = (rmrc.solve(rmrc.load(path, overrides={"duration": 1.0})) for _ in range(2))
    for name in ("time", "q", "v", "status", "sigma_min", "active", "kkt"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    for name, error in first.error.items():
        assert np.array_equal(error, second.error[name])


def test_a_run_saved_loaded_and_saved_again_is_identical(tmp_path: Path) -> None:
    path = REPOSITORY / "configs" / "planar_line.yaml"
    run = rmrc.solve(rmrc.load(path, overrides={"duration": 0.5}))
    run.save(tmp_path / "first")
    rmrc.Run.load(tmp_path / "first").save(tmp_path / "second")
    for name in ("run.json", "trajectory.npz", "report.html"):
        first, second = (tmp_path / folder / name for folder in ("first", "second"))
        assert first.read_bytes() == second.read_bytes(), name


@pytest.mark.parametrize("name", ["panda_reach", "panda_line", "ur5e_waypoints"])
def test_the_path_is_the_same_at_every_dt(name: str) -> None:
    path = REPOSITORY / "configs" / f"{name}.yaml"
    runs = {
        dt: rmrc.solve(
            rmrc.load(path, overrides={"dt": dt, "duration": 3.0, "damping.curvature": False})
        )
        for dt in (0.001, 0.002, 0.005, 0.01)
    }
    fine = runs[0.001]
    apart = {}
    for dt, run in runs.items():
        stride = round(dt / 0.001)
        apart[dt] = float(np.abs(run.q - fine.q[::stride]).max())
    # Euler's method, without X, which has dt in it: the paths come together in proportion to dt;
    # 1.5 allows for second order.
    for small, large in ((0.002, 0.005), (0.005, 0.01)):
        assert apart[small] <= 1.5 * apart[large] * (small - 0.001) / (large - 0.001)
    assert apart[0.002] < 0.01
