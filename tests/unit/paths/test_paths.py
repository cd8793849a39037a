"""Every path: pose and twist agree, ends are hit, mistakes are explained."""

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, seed
from hypothesis import strategies as st
from sampled_paths import (
    COORDINATES,
    DIFFERENCE,
    EXACT,
    START,
    Array,
    difference,
    gap,
    rotation,
    sample,
)

from rmrc.errors import ConfigError
from rmrc.paths import ArcPath, CirclePath, HoldPath, LinePath, PathModel, PosePath, WaypointsPath
from rmrc.paths.geometry import Turn
from rmrc.paths.profiles import PROFILES, ProfileName
from rmrc.text.base import Pose

ROOT = Path("unused")
ORIGIN = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
HALF_TURN = (0.0, 0.6, 0.0, -0.8)
PROFILE_NAMES = get_args(ProfileName)

MOVING: dict[str, Callable[..., PathModel]] = {
    "line": lambda **kw: LinePath(
        to=Pose(position=(0.3, -0.2, 0.6), quaternion=(0.7, 0.1, -0.5, 0.2)), **kw
    ),
    "line from": lambda **kw: LinePath(
        from_=Pose(position=(0.1, 0.2, 0.3), quaternion=(0.1, 0.9, 0.3, 0.2)),
        to=Pose(position=(0.3, -0.2, 0.6)),
        **kw,
    ),
    "line that turns": lambda **kw: LinePath(to=Pose(quaternion=(0.7, 0.1, -0.5, 0.2)), **kw),
    "arc": lambda **kw: ArcPath(
        via=(0.6, 0.3, 0.5),
        to=Pose(position=(0.2, 0.3, 0.1), quaternion=(0.2, 0.8, 0.0, 0.5)),
        **kw,
    ),
    "circle": lambda **kw: CirclePath(
        center=(0.4, 0.3, 0.1), normal=(1.0, -2.0, 0.5), turns=-1.5, **kw
    ),
    "circle that follows": lambda **kw: CirclePath(
        center=(0.4, 0.3, 0.1), normal=(1.0, -2.0, 0.5), turns=2.0, orientation="follow", **kw
    ),
    "waypoints": lambda **kw: WaypointsPath(
        through=(
            Pose(position=(0.3, -0.2, 0.6)),
            Pose(quaternion=(0.7, 0.1, -0.5, 0.2)),
            Pose(position=(0.1, 0.2, 0.3), quaternion=(-0.1, 0.9, 0.3, 0.2)),
        ),
        **kw,
    ),
}


# Pose and twist.


@pytest.mark.parametrize(
    ("name", "profile", "coordinates"), list(product(MOVING, PROFILE_NAMES, COORDINATES))
)
def test_the_twist_is_the_derivative_of_the_pose(name: str, profile: str, coordinates: str) -> None:
    model = MOVING[name](profile=profile, coordinates=coordinates, duration=1.7, delay=0.3)
    trajectory = model.build(START, ROOT)
    times = np.random.default_rng(0).uniform(0.3, 2.0, 40)
    moved = 0.0
    for time in times:
        pose, twist = sample(trajectory, time)
        assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=EXACT)
        np.testing.assert_allclose(twist, difference(trajectory, time), atol=DIFFERENCE)
        moved = max(moved, float(np.abs(twist).max()))
    assert moved > 0.1


@pytest.mark.parametrize("name", MOVING)
def test_start_coordinates_move_the_whole_path_with_the_start(name: str) -> None:
    at_start = MOVING[name](coordinates="start", duration=1.0).build(START, ROOT)
    at_origin = MOVING[name](coordinates="world", duration=1.0).build(ORIGIN, ROOT)
    turn = rotation(START)
    for time in (0.0, 0.2, 0.5, 0.9, 1.0):
        (pose, twist), (local, local_twist) = sample(at_start, time), sample(at_origin, time)
        np.testing.assert_allclose(pose[:3], START[:3] + turn.apply(local[:3]), atol=EXACT)
        assert (rotation(pose).inv() * turn * rotation(local)).magnitude() < EXACT
        np.testing.assert_allclose(twist[:3], turn.apply(local_twist[:3]), atol=EXACT)
        np.testing.assert_allclose(twist[3:], turn.apply(local_twist[3:]), atol=EXACT)


# Beginnings, ends and speeds.


@pytest.mark.parametrize(("name", "profile"), list(product(MOVING, PROFILE_NAMES)))
def test_before_and_after_the_motion_the_target_rests(name: str, profile: str) -> None:
    trajectory = MOVING[name](profile=profile, duration=1.7, delay=0.3).build(START, ROOT)
    assert trajectory.duration == pytest.approx(2.0, abs=EXACT)
    begin, end = sample(trajectory, -1.0)[0], sample(trajectory, 1e9)[0]
    for time, rest in ((0.0, begin), (0.2999, begin), (trajectory.duration, end), (5.0, end)):
        pose, twist = sample(trajectory, time)
        np.testing.assert_array_equal(pose, rest)
        np.testing.assert_array_equal(twist, np.zeros(6))
    # The motion joins both ends without a jump.
    np.testing.assert_allclose(sample(trajectory, 0.3)[0], begin, atol=EXACT)
    assert gap(sample(trajectory, trajectory.duration - 1e-9)[0], end) < 1e-7
    if name != "line from":
        np.testing.assert_allclose(begin, START, atol=EXACT)


@pytest.mark.parametrize(("name", "profile"), list(product(MOVING, ("trapezoid", "minimum_jerk"))))
def test_smooth_profiles_begin_and_end_at_rest(name: str, profile: str) -> None:
    trajectory = MOVING[name](profile=profile, duration=1.0).build(START, ROOT)
    np.testing.assert_array_equal(sample(trajectory, 0.0)[1], np.zeros(6))
    # The last number below the end: what is left of the speed is rounding.
    last = np.nextafter(trajectory.duration, 0.0)
    np.testing.assert_allclose(sample(trajectory, float(last))[1], np.zeros(6), atol=EXACT)


@pytest.mark.parametrize("name", ["line", "arc", "circle", "circle that follows"])
def test_a_constant_profile_keeps_one_speed(name: str) -> None:
    trajectory = MOVING[name](profile="constant", duration=1.0).build(START, ROOT)
    twists = np.array([sample(trajectory, time)[1] for time in np.linspace(0.0, 0.999, 50)])
    for part in (twists[:, :3], twists[:, 3:]):
        speeds = np.linalg.norm(part, axis=1)
        np.testing.assert_allclose(speeds, speeds[0], atol=EXACT)


@pytest.mark.parametrize(
    ("name", "profile"), list(product(["line", "arc", "circle", "line that turns"], PROFILE_NAMES))
)
def test_a_speed_is_the_largest_speed(name: str, profile: str) -> None:
    trajectory = MOVING[name](profile=profile, speed=0.25).build(START, ROOT)
    part = slice(3, 6) if name == "line that turns" else slice(0, 3)

    def speed(share: float) -> float:
        return float(np.linalg.norm(sample(trajectory, share * trajectory.duration)[1][part]))

    assert speed(0.5) == pytest.approx(0.25, rel=EXACT)
    assert max(map(speed, np.linspace(0, 1, 101))) <= 0.25 * (1 + EXACT)


def test_a_turn_nearly_on_the_spot_takes_its_speed_in_radians() -> None:
    quarter = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    to = Pose(position=(1e-5, 0.0, 0.0), quaternion=quarter)
    model = LinePath(to=to, coordinates="start", profile="constant", speed=0.1)
    trajectory = model.build(START, ROOT)
    assert trajectory.duration == pytest.approx(np.pi / 2 / 0.1, rel=EXACT)
    assert np.linalg.norm(sample(trajectory, 1.0)[1][3:]) == pytest.approx(0.1, rel=EXACT)


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_covers_the_whole_and_never_passes_its_peak(profile: ProfileName) -> None:
    at, peak = PROFILES[profile]
    shares, rates = np.array([at(tau) for tau in np.linspace(0, 1, 1001)]).T
    assert (shares[0], shares[-1]) == pytest.approx((0.0, 1.0), abs=EXACT)
    assert np.all(np.diff(shares) > 0)
    assert rates.max() == pytest.approx(peak, rel=EXACT)


@pytest.mark.parametrize("timing", [{"speed": 0.5}, {"duration": 2.0}])
def test_a_path_of_no_length(timing: dict[str, Any]) -> None:
    trajectory = LinePath(to=Pose(), **timing).build(START, ROOT)
    assert trajectory.duration == timing.get("duration", 0.0)
    for time in (0.0, 1.0, 3.0):
        pose, twist = sample(trajectory, time)
        np.testing.assert_allclose(pose, START, atol=EXACT)
        np.testing.assert_array_equal(twist, np.zeros(6))


@pytest.mark.parametrize(
    "model",
    [
        LinePath(to=Pose(position=(1e99, 1e99, 1e99)), speed=1e-300),
        LinePath(to=Pose(position=(1.0, 1.0, 1.0)), speed=1e-310),
        LinePath(to=Pose(position=(1.0, 1.0, 1.0)), duration=1e-310),
        CirclePath(center=(1e99, 0, 0), normal=(0, 0, 1), turns=1e99, speed=1e-200),
    ],
)
def test_a_path_beyond_all_numbers_is_refused(model: PathModel) -> None:
    with pytest.raises(ConfigError, match="too large or too small"):
        model.build(START, ROOT)


# Each path's own shape.


def test_hold_rests_at_the_start() -> None:
    trajectory = HoldPath().build(START, ROOT)
    assert trajectory.duration == 0.0
    for time in (-1.0, 0.0, 7.0):
        pose, twist = sample(trajectory, time)
        np.testing.assert_array_equal(pose, START)
        np.testing.assert_array_equal(twist, np.zeros(6))


def test_pose_jumps() -> None:
    goal = np.array([0.1, 0.2, 0.3, 0.6, 0.0, 0.8, 0.0])
    model = PosePath(position=(0.1, 0.2, 0.3), quaternion=(0.6, 0.0, 0.8, 0.0))
    trajectory = model.build(START, ROOT)
    assert trajectory.duration == 0.0
    pose, twist = sample(trajectory, 0.0)
    assert gap(pose, goal) < EXACT
    np.testing.assert_array_equal(twist, np.zeros(6))
    late = model.model_copy(update={"delay": 1.0}).build(START, ROOT)
    np.testing.assert_array_equal(sample(late, 0.99)[0], START)
    assert gap(sample(late, 1.0)[0], goal) < EXACT


@pytest.mark.parametrize(
    ("model", "end"),
    [
        (PosePath(position=(1, 2, 3)), [1, 2, 3, *START[3:]]),
        (PosePath(quaternion=(0, 0, 0, -2)), [*START[:3], 0, 0, 0, 1]),
        (PosePath(position=(0, 0, 1), coordinates="start"), [*START[:3], *START[3:]]),
    ],
)
def test_what_a_pose_leaves_out_stays(model: PosePath, end: list[float]) -> None:
    goal = np.array(end, dtype=float)
    if model.coordinates == "start":
        goal[:3] += rotation(START).apply([0.0, 0.0, 1.0])
    assert gap(sample(model.build(START, ROOT), 0.0)[0], goal) < EXACT


def test_a_line_is_straight_between_its_ends() -> None:
    begin, end = np.array([0.1, 0.2, 0.3]), np.array([0.3, -0.2, 0.6])
    trajectory = MOVING["line from"](duration=1.0).build(START, ROOT)
    np.testing.assert_allclose(sample(trajectory, 0.0)[0][:3], begin, atol=EXACT)
    np.testing.assert_allclose(sample(trajectory, 0.5)[0][:3], (begin + end) / 2, atol=EXACT)
    np.testing.assert_allclose(sample(trajectory, 1.0)[0][:3], end, atol=EXACT)
    # `to` leaves the orientation out, so it stays as `from` has it.
    kept = np.array([0.1, 0.9, 0.3, 0.2]) / np.linalg.norm([0.1, 0.9, 0.3, 0.2])
    np.testing.assert_allclose(sample(trajectory, 1.0)[0][3:], kept, atol=EXACT)


@pytest.mark.parametrize(
    ("via", "end"),
    [
        ((0.6, 0.3, 0.5), (0.2, 0.3, 0.1)),
        ((0.6, 0.3, 0.5), (0.55, 0.1, 0.45)),  # the long way round: more than half a circle
        ((0.5, 0.2, 0.4001), (0.5, 0.3, 0.4)),  # nearly straight
    ],
)
def test_an_arc_passes_its_points_on_one_circle(
    via: tuple[float, float, float], end: tuple[float, float, float]
) -> None:
    model = ArcPath(via=via, to=Pose(position=end), profile="constant", duration=1.0)
    trajectory = model.build(START, ROOT)
    points = np.array([sample(trajectory, time)[0][:3] for time in np.linspace(0, 1, 2001)])
    np.testing.assert_allclose(points[0], START[:3], atol=EXACT)
    np.testing.assert_allclose(points[-1], end, atol=EXACT)
    nearest = np.linalg.norm(points - via, axis=1).argmin()
    step = np.linalg.norm(points[1] - points[0])
    assert np.linalg.norm(points[nearest] - via) <= step
    assert 0 < nearest < 2000
    # Equal chords between equal times, and every point in one plane: a circle.
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), step, atol=EXACT)
    normal = np.cross(np.subtract(via, START[:3]), np.subtract(end, START[:3]))
    normal /= np.linalg.norm(normal)
    np.testing.assert_allclose((points - START[:3]) @ normal, 0.0, atol=EXACT)


@pytest.mark.parametrize(
    ("via", "end"),
    [
        ((0.6, 0.2, 0.5), (0.8, 0.4, 0.7)),
        ((0.5, 0.1, 0.4), (1, 1, 1)),
        ((1, 1, 1), (1, 1, 1)),
    ],
)
def test_an_arc_through_points_on_one_line_is_refused(
    via: tuple[float, float, float], end: tuple[float, float, float]
) -> None:
    with pytest.raises(ConfigError, match=r"lie on one line.*\[0\.5, 0\.1, 0\.4\]"):
        ArcPath(via=via, to=Pose(position=end), duration=1.0).build(START, ROOT)


def test_a_circle_keeps_its_radius_and_closes() -> None:
    center, normal = np.array([0.4, 0.3, 0.1]), np.array([1.0, -2.0, 0.5])
    axis = normal / np.linalg.norm(normal)

    def radius(pose: Array) -> float:
        return float(np.linalg.norm(np.cross(axis, pose[:3] - center)))

    trajectory = MOVING["circle that follows"](duration=1.0).build(START, ROOT)
    for time in np.linspace(0, 1, 21):
        pose, _ = sample(trajectory, time)
        assert radius(pose) == pytest.approx(radius(START), abs=EXACT)
        assert axis @ (pose[:3] - START[:3]) == pytest.approx(0.0, abs=EXACT)
        # The whole pose turns as one: seen from the target, the axis stays where it was.
        seen = rotation(pose).inv().apply(center - pose[:3])
        np.testing.assert_allclose(
            np.cross(rotation(pose).inv().apply(axis), seen),
            np.cross(
                rotation(START).inv().apply(axis), rotation(START).inv().apply(center - START[:3])
            ),
            atol=EXACT,
        )
    assert gap(sample(trajectory, 1.0)[0], START) < EXACT


def test_turns_go_about_the_normal_by_the_right_hand_rule() -> None:
    def quarter(turns: float) -> Array:
        model = CirclePath(center=(0, 0, 0), normal=(0, 0, 2), turns=turns, duration=1.0)
        pose, _ = sample(model.build(np.array([1.0, 0, 5, 1, 0, 0, 0]), ROOT), 1.0)
        return pose

    np.testing.assert_allclose(quarter(0.25), [0, 1, 5, 1, 0, 0, 0], atol=EXACT)
    np.testing.assert_allclose(quarter(-0.25), [0, -1, 5, 1, 0, 0, 0], atol=EXACT)


def test_a_circle_about_its_own_start_is_refused() -> None:
    with pytest.raises(ConfigError, match="no radius"):
        CirclePath(center=(0.5, 0.1, 9), normal=(0, 0, 1), duration=1.0).build(START, ROOT)


def test_waypoints_take_time_by_length_and_rest_at_each() -> None:
    through = (Pose(position=(0.5, 0.1, 0.7)), Pose(position=(0.5, 0.2, 0.7), quaternion=HALF_TURN))
    last = Pose(position=(0.5, 0.2, 0.6))
    trajectory = WaypointsPath(through=(*through, last), duration=5.0).build(START, ROOT)
    for time, position in ((3.0, (0.5, 0.1, 0.7)), (4.0, (0.5, 0.2, 0.7)), (5.0, (0.5, 0.2, 0.6))):
        pose, twist = sample(trajectory, time)
        np.testing.assert_allclose(pose[:3], position, atol=EXACT)
        np.testing.assert_allclose(twist, 0.0, atol=EXACT)
    # The last pose leaves the orientation out, so it stays as at the one before.
    assert gap(sample(trajectory, 5.0)[0], np.array([0.5, 0.2, 0.6, *HALF_TURN])) < EXACT


def test_constant_waypoints_pass_through_at_one_speed() -> None:
    through = (Pose(position=(0.5, 0.1, 0.7)), Pose(position=(0.9, 0.1, 0.7)))
    trajectory = WaypointsPath(through=through, profile="constant", speed=0.1).build(START, ROOT)
    assert trajectory.duration == pytest.approx(7.0, rel=EXACT)
    for time in (0.0, 1.0, 2.9999, 3.0001, 6.9):
        assert np.linalg.norm(sample(trajectory, time)[1]) == pytest.approx(0.1, rel=EXACT)


# Orientation.

unit = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(unit, unit, unit, unit)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


@seed(0)
@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_a_turn_is_the_shortest_and_knows_no_sign(begin: Array, end: Array, s: float) -> None:
    turn = Turn.between(tuple(begin), tuple(end))
    assert 0.0 <= turn.angle <= np.pi
    pose, other, twist = np.zeros(7), np.zeros(7), np.zeros(6)
    for share, goal in ((0.0, begin), (1.0, end)):
        turn.at(share, 0.0, pose, twist)
        assert gap(pose, np.array([0, 0, 0, *goal])) < EXACT
    turn.at(s, 1.0, pose, twist)
    for signs in ((1, -1), (-1, 1), (-1, -1)):
        Turn.between(tuple(signs[0] * begin), tuple(signs[1] * end)).at(s, 0.0, other, twist)
        assert gap(pose, other) < EXACT


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("nearness", [0.0, 1e-17, 1e-9])
def test_half_a_turn_is_finite_and_arrives(sign: int, nearness: float) -> None:
    goal = sign * np.array([nearness, 0.6, 0.0, -0.8])
    w, x, y, z = goal.tolist()
    model = LinePath(to=Pose(quaternion=(w, x, y, z)), profile="constant", duration=1.0)
    trajectory = model.build(ORIGIN, ROOT)
    pose, twist = sample(trajectory, 0.5)
    np.testing.assert_allclose(twist[3:], [0.6 * np.pi, 0.0, -0.8 * np.pi], atol=3e-9)
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=EXACT)
    assert gap(sample(trajectory, 1.0)[0], np.array([0, 0, 0, *goal])) < EXACT
