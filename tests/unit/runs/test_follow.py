"""The three ways of following a line: where they part, and what they cost."""

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from rmrc.runs.check import check

LINE = REPOSITORY / "configs" / "panda_line.yaml"


@pytest.fixture(scope="module")
def runs() -> dict[str, rmrc.Run]:
    return {
        way: rmrc.solve(rmrc.load(LINE, overrides={"follow": way, "dt": 0.005}))
        for way in ("rate", "waypoints", "joint")
    }


def test_all_arrive_and_keep_the_limits(runs) -> None:
    for way, run in runs.items():
        assert run.summary["converged"], way
        assert all(limit["max_violation"] == 0 for limit in run.summary["limits"].values()), way


def test_rates_and_waypoints_stay_on_the_line_and_joints_leave_it(runs) -> None:
    off = {way: run.summary["tasks"]["hand"]["line"]["max"] for way, run in runs.items()}
    assert off["rate"] < 1e-4
    assert off["waypoints"] < 1e-4
    assert off["joint"] > 5e-3


def test_the_number_of_solves_tells_them_apart(runs) -> None:
    solves = {way: run.summary["solves"] for way, run in runs.items()}
    assert solves["rate"] == runs["rate"].summary["steps"]
    assert solves["waypoints"] > solves["rate"]
    assert solves["joint"] < 50


def test_joints_are_interpolated_straight_in_their_own_space(runs) -> None:
    q = runs["joint"].q
    along = q[-1] - q[0]
    share = (q - q[0]) @ along / (along @ along)
    assert np.abs(q - q[0] - np.outer(share, along)).max() < 1e-9
    assert np.diff(share).min() > -1e-9


def test_a_path_without_a_profile_cannot_be_followed_by_joints() -> None:
    reach = REPOSITORY / "configs" / "panda_reach.yaml"
    with pytest.raises(rmrc.ConfigError, match="joint needs a target on a path with a duration"):
        rmrc.solve(rmrc.load(reach, overrides={"follow": "joint"}))


TWO = {
    "profile": {"profile": "trapezoid"},
    "delay": {"delay": 0.5},
    "duration": {"duration": 2.0},
}


def two_hands(**second: object) -> rmrc.Config:
    line = {"path": "line", "to": {"position": [0.5, 0.2, 1.1]}, "duration": 1.0}
    other = {"path": "line", "to": {"position": [0.5, -0.2, 1.1]}, "duration": 1.0, **second}
    tasks = [
        {"name": hand, "type": "frame", "frame": {"site": f"{hand}_hand"}}
        for hand in ("left", "right")
    ]
    scene = str(REPOSITORY / "scenes" / "dual_arm.xml")
    targets = {"left": line, "right": other}
    return config(
        scene, tasks, start="home", dt=0.01, duration=1.5, follow="joint", targets=targets
    )


@pytest.mark.parametrize("differs", TWO)
def test_joints_say_that_two_targets_cannot_keep_times_of_their_own(differs: str) -> None:
    given = two_hands(**TWO[differs])
    for use in (rmrc.solve, check):
        with pytest.raises(rmrc.ConfigError, match=r"'left' takes .* where 'right' takes"):
            use(given)


def test_joints_follow_two_targets_with_the_same_time() -> None:
    run = rmrc.solve(two_hands())
    assert all(task["final"] < 1e-3 for task in run.summary["tasks"].values())
