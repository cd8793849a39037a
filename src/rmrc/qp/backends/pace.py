"""What fits into a time, by what earlier work took: for solvers that do not look at the clock."""

from math import inf

FADING = 0.9
"""What each forecast leaves of the estimate, so that one interruption is forgotten in a while and
what was too long for its time is tried again."""


class Pace:
    """How long one unit of some work takes: the longest that was measured lately."""

    def __init__(self) -> None:
        self._each = 0.0

    def within(self, seconds: float) -> float:
        """Return how many units are expected to end within `seconds`: one before any is measured.

        All there are within inf.
        """
        if not self._each:
            return inf if seconds == inf else float(seconds > 0.0)
        self._each *= FADING
        return seconds / self._each

    def measure(self, seconds: float, units: int) -> None:
        """Take note that so many units took `seconds`."""
        self._each = max(self._each, seconds / max(units, 1))
