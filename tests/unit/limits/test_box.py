"""The box of the joint limits: never empty, in the stated order of precedence, and kept."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rmrc.limits.box import Box, BoxLimit

Array = NDArray[np.float64]

# The box is computed by a handful of roundings on numbers up to 1e6.
ROUNDING = 1e-9
# A change of acceleration is a second difference of velocities: their rounding over dt and j dt.
JERK_ROUNDING = 1e-6
# A drive into the end of the range may take this much longer than the quickest one by jerks ±j.
SLOWER = 1.1


def limits(
    lower=-1.0,
    upper=1.0,
    gain=1.0,
    velocity=np.inf,
    acceleration=np.inf,
    jerk=np.inf,
    step=np.inf,
    joints=1,
) -> BoxLimit:
    every = np.ones(joints)
    return BoxLimit(
        Box(
            coordinate=np.arange(joints),
            lower=lower * every,
            upper=upper * every,
            gain=gain,
            velocity=velocity * every,
            acceleration=acceleration * every,
            jerk=jerk * every,
            step=step * every,
        )
    )


def bounds(box: BoxLimit, q: float, v: float, dt: float, a: float = 0.0) -> tuple[float, float]:
    box.update(np.array([q]), np.array([v]), np.array([a]), dt)
    return float(box.lower[0]), float(box.upper[0])


LIMITS = st.one_of(st.just(np.inf), st.floats(1e-3, 1e3))


@seed(0)
@given(
    q=st.floats(-1e3, 1e3),
    v=st.floats(-100, 100),
    a=st.floats(-1e3, 1e3),
    dt=st.floats(1e-6, 10),
    gain=st.floats(0.01, 1),
    width=st.sampled_from([0.0, 1e-6, 1.0]),
    velocity=LIMITS,
    acceleration=LIMITS,
    jerk=LIMITS,
)
def test_the_box_is_never_empty_and_keeps_the_order(
    q, v, a, dt, gain, width, velocity, acceleration, jerk
) -> None:
    box = limits(-width, width, gain, velocity, acceleration, jerk)
    outside = box.update(np.array([q]), np.array([v]), np.array([a]), dt)
    low, high = float(box.lower[0]), float(box.upper[0])
    assert low <= high
    assert outside == (not -width - 1e-9 <= q <= width + 1e-9)
    # Acceleration holds whatever the others say; velocity where acceleration lets it.
    assert low >= v - acceleration * dt - ROUNDING
    assert high <= v + acceleration * dt + ROUNDING
    if abs(v) <= velocity:
        assert -velocity - ROUNDING <= low
        assert high <= velocity + ROUNDING


def test_position_asks_for_a_share_of_the_room() -> None:
    assert bounds(limits(gain=0.5), q=0.8, v=0.0, dt=0.1) == (-9.0, 0.9999999999999998)


def test_velocity_caps_the_way_back_from_outside() -> None:
    assert bounds(limits(velocity=2.0), q=1.5, v=0.0, dt=0.002) == (-2.0, -2.0)


def test_the_position_limit_is_reached_from_outside_without_overshoot() -> None:
    low, high = bounds(limits(velocity=2.0), q=1.001, v=0.0, dt=0.002)
    assert high == np.float64(1.0 - 1.001) / 0.002
    assert low == -2.0


def test_a_joint_without_any_limit_is_free() -> None:
    assert bounds(limits(-np.inf, np.inf), q=5.0, v=0.0, dt=0.1) == (-np.inf, np.inf)


@pytest.mark.parametrize("dt", [1e-3, 0.1, 10.0])
def test_no_joint_moves_further_in_a_step_than_it_may(dt: float) -> None:
    low, high = bounds(limits(-np.inf, np.inf, velocity=2.0, step=0.5), q=0.0, v=0.0, dt=dt)
    assert high == min(2.0, 0.5 / dt)
    assert low == -high


def test_limits_of_some_joints_leave_the_others_as_they_are() -> None:
    box = BoxLimit(
        Box(
            coordinate=np.array([0, 1, 2]),
            lower=np.array([-1.0, -np.inf, -1.0]),
            upper=np.array([1.0, np.inf, 1.0]),
            gain=1.0,
            velocity=np.array([2.0, 3.0, np.inf]),
            acceleration=np.array([np.inf, 5.0, np.inf]),
            jerk=np.array([np.inf, np.inf, 500.0]),
            step=np.full(3, np.inf),
        )
    )
    box.update(np.zeros(3), np.zeros(3), np.zeros(3), 0.1)
    assert box.upper == pytest.approx([2.0, 0.5, bounds(limits(jerk=500.0), 0.0, 0.0, 0.1)[1]])
    assert box.lower == pytest.approx(-box.upper)


class Motion:
    """Joints that start at rest in the middle and move inside their boxes, and what they passed."""

    def __init__(self, joints: int, **values: float):
        self.values = {"velocity": np.inf, "acceleration": np.inf, "jerk": np.inf} | values
        self.box = limits(joints=joints, **self.values)
        self.q, self.v, self.a = np.zeros((3, joints))
        self.outside = self.faster = self.harder = self.jerkier = -np.inf

    def step(self, dt: float, command: Callable[[Array, Array], Array]) -> None:
        self.box.update(self.q, self.v, self.a, dt)
        v = command(self.box.lower, self.box.upper).copy()
        a = (v - self.v) / dt
        jerk = self.values["jerk"]
        scale = max(1.0, np.abs(a).max())
        passed = np.abs(a - self.a).max() / dt - jerk
        self.jerkier = max(self.jerkier, passed / (jerk + scale / dt) if jerk < np.inf else 0.0)
        self.q, self.v, self.a = self.q + v * dt, v, a
        self.outside = max(self.outside, float(np.abs(self.q).max()) - 1.0)
        self.faster = max(self.faster, float(np.abs(v).max()) - self.values["velocity"])
        self.harder = max(self.harder, float(np.abs(a).max()) / self.values["acceleration"] - 1.0)


def wanderer(rng: np.random.Generator, joints: int) -> Callable[[Array, Array], Array]:
    """Return commands that go to one end of the box for a while, or to rest, or anywhere."""
    mode = rng.integers(0, 4, joints)

    def command(lower: Array, upper: Array) -> Array:
        changes = rng.uniform(size=joints) < 0.01
        mode[changes] = rng.integers(0, 4, joints)[changes]
        anywhere = lower + rng.uniform(size=joints) * (upper - lower)
        rest = np.clip(0.0, lower, upper)
        return np.choose(mode, [lower, upper, rest, anywhere])

    return command


STEP_LENGTHS = {
    "even": lambda rng, dt, count: np.full(count, dt),
    "jitter": lambda rng, dt, count: dt * rng.uniform(0.5, 1.5, count),
    "jumps": lambda rng, dt, count: 10.0 ** rng.uniform(-4, 1, count),
}


@pytest.mark.parametrize("lengths", STEP_LENGTHS)
@seed(0)
@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    dt=st.floats(-4, -1).map(lambda x: 10.0**x),
    acceleration=st.floats(-1, 2).map(lambda x: 10.0**x),
    velocity=st.floats(-1, 1.5).map(lambda x: 10.0**x),
    jerk=st.one_of(st.just(np.inf), st.floats(0.5, 4).map(lambda x: 10.0**x)),
    gain=st.sampled_from([0.1, 0.95, 1.0]),
    number=st.integers(0, 1000),
)
def test_limits_hold_for_any_lengths_of_the_steps(
    lengths, dt, acceleration, velocity, jerk, gain, number
) -> None:
    rng = np.random.default_rng(number)
    motion = Motion(
        20, velocity=velocity, acceleration=acceleration, jerk=jerk * acceleration, gain=gain
    )
    command = wanderer(rng, 20)
    for length in STEP_LENGTHS[lengths](rng, dt, 300):
        motion.step(length, command)
    assert motion.outside <= ROUNDING
    assert motion.faster <= ROUNDING
    assert motion.harder <= ROUNDING
    if gain >= 0.5:  # a smaller one draws the approach out further than the jerk limit foresees
        assert motion.jerkier <= JERK_ROUNDING


@pytest.mark.parametrize("velocity", [1.0, 5.0])
@pytest.mark.parametrize("acceleration", [15.0, np.inf])
@pytest.mark.parametrize("jerk", [50.0, 500.0])
@pytest.mark.parametrize("lengths", ["even", "jitter"])
def test_the_jerk_limit_holds_while_joints_wander(velocity, acceleration, jerk, lengths) -> None:
    rng = np.random.default_rng(0)
    motion = Motion(100, velocity=velocity, acceleration=acceleration, jerk=jerk)
    command = wanderer(rng, 100)
    for length in STEP_LENGTHS[lengths](rng, 0.001, 2000):
        motion.step(length, command)
    assert motion.outside <= ROUNDING
    assert motion.faster <= ROUNDING
    assert motion.jerkier <= JERK_ROUNDING


@pytest.mark.parametrize("dt", [0.0001, 0.002, 0.1, 10.0])
def test_the_fastest_joint_that_can_stop_does(dt: float) -> None:
    # From v²/2a = room, at the edge of what can be stopped, one length of the step after another.
    acceleration, v = 5.0, 2.0
    box, q = limits(acceleration=acceleration), 1.0 - 2.0**2 / 10.0
    for length in (dt, 0.5 * dt, 3.0 * dt, *[0.001] * 1000):
        v = bounds(box, q, v, length)[1]
        q += v * length
        assert q <= 1.0 + ROUNDING
    assert abs(v) <= 1e-6


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.01])
@pytest.mark.parametrize("jerk", [500.0, 1000.0, 5000.0])
def test_a_drive_into_the_end_of_the_range_keeps_every_limit(dt: float, jerk: float) -> None:
    velocity, acceleration = 2.0, 15.0
    motion = Motion(1, velocity=velocity, acceleration=acceleration, jerk=jerk, gain=0.95)
    arrival = None
    for k in range(int(2.0 / dt)):
        motion.step(dt, lambda lower, upper: upper)
        if arrival is None and motion.q[0] > 1.0 - 1e-3:
            arrival = (k + 1) * dt
    assert motion.outside <= ROUNDING
    assert motion.faster <= ROUNDING
    assert motion.harder <= ROUNDING
    assert motion.jerkier <= JERK_ROUNDING
    assert motion.q[0] == pytest.approx(1.0, abs=1e-9)
    # Two ramps of v/a + a/j and the way between them at v; and some steps, for it is in steps.
    quickest = 1.0 / velocity + velocity / acceleration + acceleration / jerk
    assert arrival is not None
    assert arrival <= SLOWER * quickest + 5.0 * dt


def test_the_jerk_limit_gives_way_to_the_range() -> None:
    # At v²/2a = room the joint must brake at once with almost all of a; by the jerk limit, with
    # no more than 0.5. Far from there it is the jerk limit that holds.
    _, high = bounds(limits(acceleration=5.0, jerk=500.0), q=0.6, v=2.0, dt=0.001)
    assert 2.0 - 5.0 * 0.001 <= high <= 2.0 - 4.9 * 0.001
    low, high = bounds(limits(acceleration=5.0, jerk=500.0), q=-0.9, v=2.0, dt=0.001)
    assert (low, high) == pytest.approx((2.0 - 0.5 * 0.001, 2.0 + 0.5 * 0.001))


@seed(0)
@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    start=st.sampled_from([1e-9, 1e-3, 0.1, 1.0]),
    v=st.floats(-5, 5),
    a=st.floats(-20, 20),
    dt=st.floats(0.001, 0.05),
    gain=st.sampled_from([0.5, 0.95, 1.0]),
    width=st.sampled_from([0.0, 0.3, 1.0]),
    acceleration=st.sampled_from([np.inf, 10.0]),
    jerk=st.sampled_from([np.inf, 500.0]),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_a_joint_outside_comes_back_monotonically(
    start, v, a, dt, gain, width, acceleration, jerk, side
) -> None:
    box = limits(-width, width, gain, 2.0, acceleration, jerk)
    q = side * (width + start)
    inward = False
    for _ in range(int(4.0 / dt)):
        low, high = bounds(box, q, v, dt, a)
        outward = high if side > 0.0 else low  # the command that resists most
        a, v = (outward - v) / dt, outward
        q += v * dt
        assert not inward or side * v <= ROUNDING or side * q <= width + ROUNDING
        inward = inward or side * v <= 0.0
    assert abs(q) <= width + 1e-6
