"""Random values in the words of a configuration."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Generator = np.random.Generator


class Drawer:
    """Draws from a generator."""

    def __init__(self, rng: Generator):
        self.rng = rng

    def chance(self, share: float) -> bool:
        """Return True in a share of the cases."""
        return bool(self.rng.random() < share)

    def among(self, *values: Any) -> Any:
        """Return one of some values."""
        return values[self.rng.integers(len(values))]

    def between(self, low: float, high: float) -> float:
        """Return a number of any order of magnitude between two."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def direction(self) -> Array:
        """Return a unit vector (3,)."""
        vector = self.rng.normal(size=3)
        return vector / np.linalg.norm(vector)

    def quaternion(self) -> Array:
        """Return a unit quaternion wxyz."""
        quaternion = self.rng.normal(size=4)
        return quaternion / np.linalg.norm(quaternion)
