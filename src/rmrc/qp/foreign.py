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


def parts(name: str, answer: object, fields: tuple[str, ...]) -> tuple[object, ...]:
    """Return what an answer has by these names.

    Raises:
        TypeError: If it has not all of them.
    """
    missing = [field for field in fields if not hasattr(answer, field)]
    if missing:
        kind = "None" if answer is None else f"a {type(answer).__name__}"
        raise TypeError(f"its {name} is {kind}, and has no {missing[0]}")
    return tuple(getattr(answer, field) for field in fields)


def unpacked(name: str, answer: object, count: int) -> tuple[object, ...]:
    """Return the parts of a tuple of so many.

    Raises:
        TypeError: If it is none.
    """
    if not isinstance(answer, tuple) or len(answer) != count:
        kind = f"{len(answer)} parts" if isinstance(answer, tuple) else f"a {type(answer).__name__}"
        raise TypeError(f"its {name} is {kind}, and not a tuple of {count}")
    return answer
