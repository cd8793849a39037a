"""What the manifest of a run must hold, so that whoever reads it need not look again."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError

from rmrc.errors import RmrcError
from rmrc.text.base import Model, Number
from rmrc.text.explain import explain
from rmrc.text.mistakes import config_error

Count = Annotated[int, Field(strict=True, ge=0)]
Truth = Annotated[bool, Field(strict=True)]
Rate = Number | tuple[Number | None, Number | None] | None
"""A largest rate; of a free joint those of its linear and its angular part; null for none."""

WIDTHS = {"free": (7, 6), "ball": (4, 3), "slide": (1, 1), "hinge": (1, 1)}
"""Numbers that a joint has in q and in v."""


class _Form(Model):
    """A part of the manifest: later versions may say more."""

    model_config = ConfigDict(extra="ignore")


class _Task(_Form):
    name: str
    type: str


class _Tolerance(_Form):
    position: Number | None = None
    orientation: Number | None = None


class _Limits(_Form):
    speed: dict[str, dict[str, Number | None]] = Field(default={})


class _Config(_Form):
    """What is read of a configuration without making a `Config` of it."""

    scene: str
    tasks: tuple[_Task, ...]
    tolerance: _Tolerance = _Tolerance()
    limits: _Limits = _Limits()


class _Joint(_Form):
    name: str
    type: Literal["free", "ball", "slide", "hinge"]
    qpos: Count
    dof: Count
    unit: Literal["m", "rad"] | None
    range: tuple[Number, Number] | None
    velocity: Rate = None
    acceleration: Rate = None
    jerk: Rate = None


class _Model(_Form):
    nq: Count
    nv: Count
    mocap: Count = 0
    joints: tuple[_Joint, ...]
    objects: tuple[str, ...] = ()


class _Error(_Form):
    type: str
    units: tuple[str, ...]


class _Column(_Form):
    rms: Number | None
    max: Number | None
    final: Number | None
    unit: str


class _Numbers(_Column):
    orientation: _Column | None = None


class _Passed(_Form):
    max_violation: Number
    joint: str | None
    unit: str | None


class _Limit(_Passed):
    started_outside: _Passed | None = None


class _Times(_Form):
    median: Number | None
    p99: Number | None
    max: Number | None


class _Summary(_Form):
    steps: Count
    converged: Truth
    engine: str
    backend: str
    method: str
    tasks: dict[str, _Numbers]
    limits: dict[str, _Limit]
    status: dict[str, Count]
    step_time_us: _Times
    real_time_factor: Number | None


class _Manifest(_Form):
    name: str
    config: _Config
    root: str
    versions: dict[str, str]
    statuses: tuple[str, ...]
    notices: tuple[str, ...] = ()
    interrupted: Truth = False
    model: _Model
    tasks: dict[str, _Error]
    summary: _Summary


def check_manifest(manifest: dict[str, Any]) -> None:
    """Check a manifest that was read.

    Raises:
        RmrcError: If a value is missing or of another type, or a joint has no place in q or v;
            each mistake is named by its place in the manifest.
    """
    try:
        _Manifest.model_validate(manifest)
    except ValidationError as error:
        mistakes = explain(_Manifest, manifest, error)
        raise RmrcError(str(config_error(mistakes))) from None
    model = manifest["model"]
    for k, joint in enumerate(model["joints"]):
        if fault := _misfit(joint, model["nq"], model["nv"]):
            raise RmrcError(f"model.joints[{k}].{fault}")


def _misfit(joint: dict[str, Any], nq: int, nv: int) -> str | None:
    """Return what of a joint does not go with its type, or with the sizes of q and v."""
    kind = joint["type"]
    for key, width, size in zip(("qpos", "dof"), WIDTHS[kind], (nq, nv), strict=True):
        if joint[key] + width > size:
            return f"{key}: {joint[key]} leaves no place for a {kind} joint among {size}"
    if joint["unit"] is None and kind != "free":
        return f"unit: a {kind} joint has one, m or rad"
    pairs = (
        rate for rate in ("velocity", "acceleration", "jerk") if isinstance(joint.get(rate), list)
    )
    if kind != "free" and (rate := next(pairs, None)):
        return f"{rate}: only a free joint has two"
    return None
