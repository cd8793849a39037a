"""The box of the joint limits: never empty, and in the stated order of precedence."""

import numpy as np
from hypothesis import given, seed
from hypothesis import strategies as st

from rmrc.problem.limits.box import Box, BoxLimit

# The box is computed by a handful of roundings on numbers up to 1e6.
ROUNDING = 1e-9


def limit(lower=-1.0, upper=1.0, gain=1.0, velocity=np.inf, acceleration=np.inf) -> BoxLimit:
    return BoxLimit(
        Box(
            coordinate=np.array([0]),
            lower=np.array([lower]),
            upper=np.array([upper]),
            gain=gain,
            velocity=np.array([velocity]),
            acceleration=np.array([acceleration]),
        )
    )


def bounds(box: BoxLimit, q: float, v: float, dt: float) -> tuple[float, float, bool]:
    outside = box.update(np.array([q]), np.array([v]), dt)
    return float(box.lower[0]), float(box.upper[0]), outside


SPEEDS = st.one_of(st.just(np.inf), st.floats(1e-3, 1e3))


@seed(0)
@given(
    q=st.floats(-1e3, 1e3),
    v=st.floats(-100, 100),
    dt=st.floats(1e-6, 10),
    gain=st.floats(0.01, 1),
    velocity=SPEEDS,
    acceleration=SPEEDS,
)
def test_the_box_is_never_empty_and_keeps_the_order(q, v, dt, gain, velocity, acceleration) -> None:
    low, high, outside = bounds(limit(-1, 1, gain, velocity, acceleration), q, v, dt)
    assert low <= high
    assert outside == (not -1 - 1e-9 <= q <= 1 + 1e-9)
    # Acceleration holds whatever the others say; velocity where acceleration lets it.
    assert low >= v - acceleration * dt - ROUNDING
    assert high <= v + acceleration * dt + ROUNDING
    if abs(v) <= velocity:
        assert -velocity - ROUNDING <= low
        assert high <= velocity + ROUNDING


def test_position_asks_for_a_share_of_the_room() -> None:
    low, high, outside = bounds(limit(-1, 1, gain=0.5), q=0.8, v=0.0, dt=0.1)
    assert (low, high) == (-9.0, 0.9999999999999998)
    assert not outside


def test_velocity_caps_the_way_back_from_outside() -> None:
    low, high, outside = bounds(limit(-1, 1, velocity=2.0), q=1.5, v=0.0, dt=0.002)
    assert (low, high) == (-2.0, -2.0)
    assert outside


def test_the_position_limit_is_reached_from_outside_without_overshoot() -> None:
    low, high, _ = bounds(limit(-1, 1, velocity=2.0), q=1.001, v=0.0, dt=0.002)
    assert high == np.float64(1.0 - 1.001) / 0.002
    assert low == -2.0


def test_a_joint_can_always_stop_before_its_limit() -> None:
    dt, q, v = 0.002, 0.0, 0.0
    box = limit(-1, 1, gain=0.95, velocity=3.0, acceleration=5.0)
    for _ in range(3000):
        low, v, _ = bounds(box, q, v, dt)  # as fast towards the upper limit as the box allows
        assert low <= v
        q += v * dt
        assert q <= 1.0
    assert q > 0.99


def test_a_joint_without_any_limit_is_free() -> None:
    low, high, outside = bounds(limit(-np.inf, np.inf), q=5.0, v=0.0, dt=0.1)
    assert (low, high) == (-np.inf, np.inf)
    assert not outside
