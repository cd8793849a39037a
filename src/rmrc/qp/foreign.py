"""What tasks and limits of mink's answer, looked at before a program is made of it."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def checked(
    name: str, answer: object, shape: tuple[int | None, ...], *, unlimited: bool = False
) -> Array:
    """Return an answer as an array of this shape.

    Args:
        name: What a message calls it.
        answer: What somebody else's code has returned.
        shape: Its shape, None for any length.
        unlimited: Whether +∞ is a number that it may hold.

    Raises:
        ValueError: If it is no array of numbers, has another shape, or is not finite.
        TypeError: If it is no array of numbers.
    """
    array = np.asarray(answer, dtype=float)
    if array.ndim != len(shape) or any(
        size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
    ):
        expected = tuple("any" if size is None else size for size in shape)
        raise ValueError(f"its {name} has the shape {array.shape}, and not {expected}")
    sound = array > -np.inf if unlimited else np.isfinite(array)  # NaN is neither
    if not sound.all():
        raise ValueError(f"its {name} is not finite")
    return array
