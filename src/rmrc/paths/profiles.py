"""How a target spends its time along a path: the share s(τ) covered at the share τ of the time."""

from collections.abc import Callable
from typing import Literal, NamedTuple

ProfileName = Literal["constant", "trapezoid", "minimum_jerk"]

# Share of the time that a trapezoid accelerates for, and again that it brakes for.
RAMP = 0.25


def constant(tau: float) -> tuple[float, float]:
    """Return s and ds/dτ at one speed throughout: s = τ."""
    return tau, 1.0


def trapezoid(tau: float) -> tuple[float, float]:
    """Return s and ds/dτ of a trapezoidal speed: it rises for ¼ of the time and falls for ¼.

    With a = ¼ and the largest speed p = 1/(1 − a): s = pτ²/(2a) up to τ = a, p(τ − a/2) up to
    1 − a, and 1 − p(1 − τ)²/(2a) to the end.

    Source: Siciliano, Sciavicco, Villani and Oriolo, Robotics: Modelling, Planning and Control
    (2009), section 4.2.1.
    """
    peak = 1.0 / (1.0 - RAMP)
    if tau < RAMP:
        return peak * tau * tau / (2.0 * RAMP), peak * tau / RAMP
    left = 1.0 - tau
    if left < RAMP:
        return 1.0 - peak * left * left / (2.0 * RAMP), peak * left / RAMP
    return peak * (tau - 0.5 * RAMP), peak


def minimum_jerk(tau: float) -> tuple[float, float]:
    """Return s and ds/dτ of the least integral of squared jerk: s = 10τ³ − 15τ⁴ + 6τ⁵.

    Source: Flash and Hogan, The coordination of arm movements: an experimentally confirmed
    mathematical model, Journal of Neuroscience 5(7), 1985.
    """
    square = tau * tau
    share = square * tau * (10.0 + tau * (6.0 * tau - 15.0))
    return share, 30.0 * square * (1.0 - tau) ** 2


class Profile(NamedTuple):
    """A profile and its largest ds/dτ: a path of length L at top speed v takes L·peak/v."""

    at: Callable[[float], tuple[float, float]]
    """s and ds/dτ at a share τ of the time, 0 ≤ τ ≤ 1."""
    peak: float
    """Largest ds/dτ."""


PROFILES: dict[ProfileName, Profile] = {
    "constant": Profile(constant, peak=1.0),
    "trapezoid": Profile(trapezoid, peak=1.0 / (1.0 - RAMP)),
    "minimum_jerk": Profile(minimum_jerk, peak=15.0 / 8.0),
}
