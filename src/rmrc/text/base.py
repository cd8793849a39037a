"""The base class and the value types that every part of a configuration is made of."""

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from rmrc.text.annotations import NameOf
from rmrc.text.explain import explain
from rmrc.text.mistakes import config_error
from rmrc.text.source import FrameKind, Offset

FRAME_KINDS: tuple[FrameKind, ...] = ("site", "body", "geom")

# Eigenvalues of a weight matrix down to this share of the largest count as zero, not negative.
SEMIDEFINITE_TOLERANCE = 1e-9

LARGEST_NUMBER = 1e100
"""Size of the largest number that is taken: what is computed from its square is still a float."""


class _Explaining(type(BaseModel)):
    """Has a model that is built in Python raise a `ConfigError`, as one from a file does.

    Models inside it are made by pydantic without this call, so that all mistakes come together.
    """

    def __call__(cls, *args: Any, **values: Any) -> Any:
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            raise config_error(explain(cls, values, error)) from None


if TYPE_CHECKING:  # keeps the constructors' own signatures
    _Explained = BaseModel
else:

    class _Explained(BaseModel, metaclass=_Explaining):
        pass


class Model(_Explained):
    """A part of a configuration: frozen, and an unknown key is a mistake.

    Raises:
        ConfigError: If a value is wrong; the message lists every mistake.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def _plain(value: Any) -> Any:
    """Turn numpy arrays and scalars into plain lists and numbers, for callers from Python.

    Raises ValueError where a number is too large to compute with.
    """
    value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    _is_number(value)
    return value


def _is_number(value: Any) -> bool:
    """Tell whether a value is a finite number; ValueError if it is too large to compute with."""
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    if LARGEST_NUMBER < abs(value) < math.inf:
        raise ValueError(f"a number cannot be larger than {LARGEST_NUMBER:g}")
    return math.isfinite(value)


def _weight(value: Any) -> float | tuple[float, ...] | tuple[tuple[float, ...], ...]:
    """Validate a weight: a number, a diagonal, or a symmetric positive semi-definite matrix."""
    value = _plain(value)
    if _is_number(value):
        if value < 0:
            raise ValueError(f"a weight cannot be negative, and this is {value}")
        return float(value)
    if isinstance(value, (list, tuple)) and value and all(map(_is_number, value)):
        if min(value) < 0:
            raise ValueError(f"a weight cannot be negative, and this diagonal has {min(value)}")
        return tuple(map(float, value))
    rows = [_plain(row) for row in value] if isinstance(value, (list, tuple)) else []
    square = rows and all(isinstance(row, (list, tuple)) and len(row) == len(rows) for row in rows)
    if not square or not all(_is_number(x) for row in rows for x in row):
        raise ValueError(
            "a weight is a finite number, a list of them (the diagonal) or a square matrix"
        )
    matrix = np.array(rows, dtype=float)
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0):
        raise ValueError("a weight matrix must be symmetric")
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] < -SEMIDEFINITE_TOLERANCE * max(abs(eigenvalues[-1]), abs(eigenvalues[0])):
        raise ValueError(
            "a weight matrix must be positive semi-definite; "
            f"its least eigenvalue is {eigenvalues[0]:.3g}"
        )
    return tuple(tuple(map(float, row)) for row in rows)


# The bounds stand with the float itself: past a validator, JSON Schema would not show them.
Number = Annotated[float, Field(strict=True, allow_inf_nan=False), BeforeValidator(_plain)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0), BeforeValidator(_plain)]
NonNegative = Annotated[
    float, Field(strict=True, allow_inf_nan=False, ge=0), BeforeValidator(_plain)
]
Share = Annotated[
    float, Field(strict=True, allow_inf_nan=False, gt=0, le=1), BeforeValidator(_plain)
]
Vector = Annotated[tuple[Number, ...], BeforeValidator(_plain)]
Vector3 = Annotated[tuple[Number, Number, Number], BeforeValidator(_plain)]


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) < 1e-12:
        raise ValueError("a direction cannot have zero length")
    return value


def _quaternion(value: Any) -> tuple[float, float, float, float]:
    value = _plain(value)
    if not isinstance(value, (list, tuple)) or len(value) != 4 or not all(map(_is_number, value)):
        raise ValueError("a quaternion is four finite numbers, in the order w, x, y, z")
    largest = max(map(abs, value))
    if largest < 1e-12:
        raise ValueError("a quaternion of zero norm is no rotation; the identity is [1, 0, 0, 0]")
    scaled = [part / largest for part in value]  # so that no square overflows
    norm = math.hypot(*scaled)
    w, x, y, z = (part / norm for part in scaled)
    return (w, x, y, z)


def _vector3(value: Any) -> tuple[float, float, float]:
    value = _plain(value)
    if not isinstance(value, (list, tuple)) or len(value) != 3 or not all(map(_is_number, value)):
        raise ValueError("three finite numbers are wanted: [x, y, z]")
    x, y, z = map(float, value)
    return (x, y, z)


Direction = Annotated[
    tuple[float, float, float], BeforeValidator(lambda value: _direction(_vector3(value)))
]
Quaternion = Annotated[tuple[float, float, float, float], BeforeValidator(_quaternion)]
Weight = Annotated[
    float | tuple[float, ...] | tuple[tuple[float, ...], ...], BeforeValidator(_weight)
]
JointName = Annotated[str, NameOf("joint")]
KeyframeName = Annotated[str, NameOf("keyframe")]
MocapName = Annotated[str, NameOf("mocap body")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_\-]*$")]


class FrameOffset(Model):
    """Where a frame is, as seen from one of the model's."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """x, y, z in m, along the axes of that frame."""
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """w, x, y, z; normalised on entry."""


class Frame(Model):
    """A frame of the model: exactly one of a site, a body or a geom, by name."""

    site: Annotated[str, NameOf("site")] | None = None
    """Name of a site."""
    body: Annotated[str, NameOf("body")] | None = None
    """Name of a body."""
    geom: Annotated[str, NameOf("geom")] | None = None
    """Name of a geom."""
    named: Annotated[str, NameOf("site or body or geom")] | None = None
    """Name of a site, a body or a geom that is the only one of its name; a text alone means this,
    as in `frame: tool0`."""
    offset: FrameOffset | None = None
    """How far the frame is displaced, as the tip of a tool that the model lacks."""

    @model_validator(mode="after")
    def _exactly_one(self) -> "Frame":
        if sum(getattr(self, kind) is not None for kind in (*FRAME_KINDS, "named")) != 1:
            raise ValueError("name exactly one of site, body and geom, as in {site: hand}")
        return self

    @property
    def kind(self) -> FrameKind | None:
        """Which of the three it is; None where only the model can say."""
        return next((kind for kind in FRAME_KINDS if getattr(self, kind) is not None), None)

    @property
    def name(self) -> str:
        """The name of the site, body or geom."""
        return getattr(self, self.kind or "named")

    @property
    def displaced(self) -> Offset | None:
        """The offset, as the scene takes it, if there is one."""
        if self.offset is None:
            return None
        return Offset(self.kind, self.name, self.offset.position, self.offset.quaternion)


def _frame(value: "str | Frame") -> Frame:
    return Frame(named=value) if isinstance(value, str) else value


if TYPE_CHECKING:
    FrameName = Frame
else:
    FrameName = Annotated[
        Frame | Annotated[str, NameOf("site or body or geom")], AfterValidator(_frame)
    ]
    """A frame, or the name of one alone."""


class Subtree(Model):
    """A body and all that hangs on it."""

    subtree: Annotated[str, NameOf("body")]
    """Name of the body."""

    def __str__(self) -> str:
        return f"the subtree of {self.subtree}"


class Pose(Model):
    """A position and an orientation, each optional: what is absent stays as it was."""

    position: Vector3 | None = None
    """x, y, z in m."""
    quaternion: Quaternion | None = None
    """w, x, y, z; normalised on entry."""
