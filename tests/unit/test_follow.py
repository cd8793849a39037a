"""The three ways of following a line: where they part, and what they cost."""

import numpy as np
import pytest

import rmrc
from models import REPOSITORY

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
