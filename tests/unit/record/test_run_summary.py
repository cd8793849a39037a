"""The summary of a run, against its arrays."""

from typing import Any

import numpy as np
import pytest
from fabricated_runs import STATUSES, TOLERANCE

from rmrc.record.channels import positions, rates
from rmrc.record.summary import summarize

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
