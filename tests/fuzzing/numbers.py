"""Numbers that nobody wants, and arrays of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Generator = np.random.Generator

AWKWARD = (0.0, -0.0, 5e-324, -1e-310, 1e-160, 1e160, -1e300, 1.7e308, -1.0, 1e12)
"""Finite numbers at the ends of the range of a double, and others."""
NOT_FINITE = (np.nan, np.inf, -np.inf)


def among(rng: Generator, *values: Any) -> Any:
    """Return one of some values."""
    return values[rng.integers(len(values))]


def sizes(rng: Generator, most: int) -> int:
    """Return a size up to `most`; small ones are as frequent as large ones."""
    return min(int(among(rng, 0, 1, 2, rng.integers(most + 1), rng.integers(most + 1))), most)


def numbers(rng: Generator, *shape: int, hostile: float) -> Array:
    """Return random numbers of one magnitude; in a share of the cases not all are sane."""
    found = rng.normal(size=shape) * 10.0 ** rng.uniform(-3, 3)
    if found.size and rng.random() < hostile:
        match rng.integers(5):
            case 0:
                found *= 10.0 ** rng.uniform(-320, 300)
            case 1:
                found *= 10.0 ** rng.uniform(-310, 290, size=shape)
            case 2:
                found[rng.random(shape) < 0.5] = 0.0
            case 3:
                found.flat[rng.integers(found.size)] = among(rng, *AWKWARD)
            case _:
                found.flat[rng.integers(found.size)] = among(rng, *NOT_FINITE)
    return found
