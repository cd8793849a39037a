"""The limits of the joints: those of the configuration, else of the model, as a `Box`."""

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError
from rmrc.limits.box import RANGE_ROUNDING, Box
from rmrc.limits.models import BaseLimit, LimitsModel, Off, PerJoint
from rmrc.model.actuators import servos
from rmrc.model.configuration import free_dofs, joint_dofs, joint_type
from rmrc.model.frames import find, names
from rmrc.model.objects import Objects
from rmrc.text.mistakes import Mistake

Array = NDArray[np.float64]
Value = TypeVar("Value")
Path = tuple[str | int, ...]

HINGE_SPEED = np.pi
"""Cap in rad/s of a joint without a stated velocity limit."""
SLIDE_SPEED = 1.0
"""Cap in m/s of a joint without a stated velocity limit."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_BALL = mujoco.mjtJoint.mjJNT_BALL
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE


def compile_box(
    objects: Objects,
    limits: LimitsModel,
    mistakes: list[Mistake],
    speeds: Mapping[str, float] | None = None,
) -> tuple[Box, list[str]]:
    """Return the limits of all dofs, and what a user should know of those of the robot.

    Args:
        objects: What of the model is not the robot.
        limits: The configuration's limits.
        mistakes: Where to add what does not fit the model.
        speeds: Velocity limits of the scene's file by joint, rad/s or m/s.
    """
    model, notices = objects.model, []
    lower, upper = _positions(objects, limits, notices, mistakes)
    box = Box(
        coordinate=_coordinates(model),
        lower=lower,
        upper=upper,
        gain=1.0 if limits.position == "off" else limits.position.gain,
        velocity=_velocities(objects, limits, speeds or {}, notices, mistakes),
        acceleration=_limit(objects, "acceleration", limits.acceleration, mistakes),
        jerk=_limit(objects, "jerk", limits.jerk, mistakes),
        step=np.full(model.nv, np.inf),
    )
    return box, notices


def select(box: Box, dofs: NDArray[np.intp]) -> Box:
    """Return the limits of the dofs of some joints, in ascending order."""
    return Box(
        coordinate=box.coordinate[dofs],
        lower=box.lower[dofs],
        upper=box.upper[dofs],
        gain=box.gain,
        velocity=box.velocity[dofs],
        acceleration=box.acceleration[dofs],
        jerk=box.jerk[dofs],
        step=box.step[dofs],
    )


def held_ranges(model: mujoco.MjModel, limits: LimitsModel) -> Array:
    """Return the range (njnt, 2) that each joint is held in, infinite without one; no margin.

    It is the configuration's; else the model's, within the control ranges of the joint's position
    actuators unless nothing would be left. That of a ball joint is [0, θ_max].
    """
    return _ranges(model, limits)[0]


def listed(model: mujoco.MjModel, joints: Sequence[int], limit: int = 6) -> str:
    """Return the names of joints as a list, cut after a few."""
    shown = ", ".join(joint_name(model, joint) for joint in joints[:limit])
    return shown + (f" and {len(joints) - limit} more" if len(joints) > limit else "")


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return what a message calls a joint."""
    return model.joint(joint).name or f"joint {joint}"


class _Source(StrEnum):
    """Where the range of a joint comes from, and what to say of it."""

    CONFIGURATION = "ranges from the configuration"
    MODEL = ""
    CONTROL = "ranges from the control ranges of position actuators"
    APART = (
        "the model's range is held, with which the actuator's control range has nothing in common"
    )
    NONE = "the model gives no range for"


def _ranges(model: mujoco.MjModel, limits: LimitsModel) -> tuple[Array, list[_Source]]:
    """Return the range (njnt, 2) of each joint, without a margin, and where it comes from."""
    held = np.tile([-np.inf, np.inf], (model.njnt, 1))
    sources = [_Source.NONE] * model.njnt
    if limits.position == "off":
        return held, sources
    controls = _position_controls(model)
    given = _known(model, limits.position.named)
    for joint, ends in enumerate(held):
        if joint in given:
            ends[:], sources[joint] = given[joint], _Source.CONFIGURATION
            continue
        if model.jnt_limited[joint]:
            ends[:], sources[joint] = model.jnt_range[joint], _Source.MODEL
            if joint_type(model, joint) == _BALL:
                ends[:] = 0.0, ends.max()
        (low, high), (least, most) = ends, controls[joint]
        if least <= low + RANGE_ROUNDING and most >= high - RANGE_ROUNDING:
            continue  # `inheritrange` rounds: such a control range is the joint's own
        if max(low, least) <= min(high, most):
            ends[:], sources[joint] = (max(low, least), min(high, most)), _Source.CONTROL
        else:
            sources[joint] = _Source.APART
    return held, sources


def _positions(
    objects: Objects, limits: LimitsModel, notices: list[str], mistakes: list[Mistake]
) -> tuple[Array, Array]:
    """Return q_min + margin and q_max − margin (nv,) of the robot's hinges and slides.

    A range of no width has no margin: it is where a joint has to stand.
    """
    model, robot = objects.model, objects.robot_joints()
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    if limits.position == "off":
        notices.append("position limits are off")
        return lower, upper
    named = limits.position.named
    _check_names(objects, ("limits", "position"), named, mistakes)
    held, sources = _ranges(model, limits)
    for joint, (low, high) in zip(robot, held[robot], strict=True):
        margin = limits.position.margin
        name, ball = joint_name(model, joint), joint_type(model, joint) == _BALL
        if ball and name in named and not 0.0 == low < high:
            message = f"'{name}' is a ball joint: its range is [0, its largest angle]"
            mistakes.append(Mistake(("limits", "position", name), message))
        if low == high:
            margin = 0.0
        if high - low < (1 if ball else 2) * margin:
            message = (
                f"joint '{name}' has a range of {high - low:.3g}, too short for a margin of "
                f"{margin:g} at {'its' if ball else 'each'} end"
            )
            mistakes.append(Mistake(("limits", "position", "margin"), message))
        if joint_type(model, joint) not in (_FREE, _BALL):
            dof = model.jnt_dofadr[joint]
            lower[dof], upper[dof] = low + margin, high - margin
    if "position" not in limits.model_fields_set:
        notices.append("position limits are on by default, from the model's ranges")
    for source in _Source:
        joints = [
            joint
            for joint in robot
            if sources[joint] is source and source.value and joint_type(model, joint) != _FREE
        ]
        if joints:
            notices.append(f"{source}: {listed(model, joints)}")
    return lower, upper


def _velocities(
    objects: Objects,
    limits: LimitsModel,
    speeds: Mapping[str, float],
    notices: list[str],
    mistakes: list[Mistake],
) -> Array:
    """Return v_max (nv,): as stated for the joint; else the smaller one of the default and what
    the file says; else of the velocity actuators; else the default cap.
    """
    model = objects.model
    speed = _limit(objects, "velocity", limits.velocity, mistakes)
    if limits.velocity == "off":
        notices.append("velocity limits are off")
    else:
        _take_speeds(objects, limits.velocity.named, speeds, speed, notices)
        controls = _velocity_controls(model)
        unstated = [j for j in objects.robot_joints() if joint_type(model, j) != _FREE]
        unstated = [j for j in unstated if np.isinf(speed[model.jnt_dofadr[j]])]
        controlled = [joint for joint in unstated if np.isfinite(controls[joint])]
        capped = [joint for joint in unstated if np.isinf(controls[joint])]
        for joint in controlled:
            speed[joint_dofs(model, joint)] = controls[joint]
        for joint in capped:
            slide = joint_type(model, joint) == _SLIDE
            speed[joint_dofs(model, joint)] = SLIDE_SPEED if slide else HINGE_SPEED
        if controlled:
            notices.append(
                "velocity limits from the control ranges of velocity actuators: "
                f"{listed(model, controlled)}"
            )
        if capped:
            notices.append(
                "joints without a stated velocity limit are capped at π rad/s and 1 m/s: "
                f"{listed(model, capped)}"
            )
    base = BaseLimit() if limits.base == "off" else limits.base
    free = np.setdiff1d(free_dofs(model), np.flatnonzero(objects.dofs)).reshape(-1, 6)
    speed[free[:, :3]], speed[free[:, 3:]] = base.linear or np.inf, base.angular or np.inf
    without = [kind for kind in ("linear", "angular") if getattr(base, kind) is None]
    if free.size and without:
        kind = "" if len(without) == 2 else f"{without[0]} "
        notices.append(f"the floating base has no {kind}speed limit")
    if limits.base != "off" and not free.size:
        notices.append("this model has no floating base that limits.base could hold")
    return speed


def _take_speeds(
    objects: Objects,
    named: Mapping[str, float],
    speeds: Mapping[str, float],
    speed: Array,
    notices: list[str],
) -> None:
    """Lower v_max (nv,) to what the file says of the joints that the configuration leaves out."""
    model, taken = objects.model, []
    for joint, value in _known(model, speeds).items():
        dofs = joint_dofs(model, joint)
        if not objects.joints[joint] and model.joint(joint).name not in named:
            if (value < speed[dofs]).any():
                taken.append(joint)
            speed[dofs] = np.minimum(speed[dofs], value)
    if taken:
        notices.append(f"velocity limits from the scene's file: {listed(model, taken)}")


def _limit(objects: Objects, key: str, limit: PerJoint | Off, mistakes: list[Mistake]) -> Array:
    """Return a limit as (nv,), infinite where none is stated."""
    return per_joint(objects, ("limits", key), limit, np.inf, mistakes)


def per_joint(
    objects: Objects, path: Path, stated: PerJoint | Off, unstated: float, mistakes: list[Mistake]
) -> Array:
    """Return what is stated for each joint as (nv,), another value where nothing is.

    Args:
        objects: What of the model is not the robot.
        path: Where in the configuration it is stated.
        stated: The values; the default is not for a floating base.
        unstated: The other value.
        mistakes: Where to add names that do not fit the model.
    """
    model = objects.model
    values = np.full(model.nv, unstated)
    if stated == "off":
        return values
    if stated.default is not None:
        values[:] = stated.default
        values[free_dofs(model)] = unstated
    _check_names(objects, path, stated.named, mistakes)
    for joint, value in _known(model, stated.named).items():
        values[joint_dofs(model, joint)] = value
    return values


def _check_names(
    objects: Objects, path: Path, named: Iterable[str], mistakes: list[Mistake]
) -> None:
    """Note the names that are no joint's, and those of objects and of floating bases."""
    model = objects.model
    for name in named:
        try:
            joint = find(model, "joint", name)
        except ModelError as unknown:
            mistakes.append(Mistake((*path, name), str(unknown), key=True))
            continue
        if objects.joints[joint]:
            root = objects.name(int(model.body_rootid[model.jnt_bodyid[joint]]))
            message = (
                f"'{name}' is a joint of '{root}', an object that is not moved; "
                "name it in `dofs` to make it part of the robot"
            )
            mistakes.append(Mistake((*path, name), message, key=True))
        elif joint_type(model, joint) == _FREE:
            message = f"'{name}' is a floating base, not a joint"
            mistakes.append(Mistake((*path, name), message, key=True))


def _known(model: mujoco.MjModel, named: Mapping[str, Value]) -> dict[int, Value]:
    """Return values by joint; a name that the model does not have is left out."""
    known = set(names(model, "joint"))
    return {model.joint(name).id: value for name, value in named.items() if name in known}


def _position_controls(model: mujoco.MjModel) -> Array:
    """Return the range (njnt, 2) that the controls of each joint's position actuators span.

    Such an actuator pulls with k (u − l) towards its control, where l is the joint's position times
    the gear.
    """
    ranges = np.tile([-np.inf, np.inf], (model.njnt, 1))
    for actuator in _controlled(model, 1):
        joint, gear = model.actuator_trnid[actuator, 0], model.actuator_gear[actuator, 0]
        low, high = np.sort(model.actuator_ctrlrange[actuator] / gear)
        ranges[joint] = max(ranges[joint, 0], low), min(ranges[joint, 1], high)
    return ranges


def _velocity_controls(model: mujoco.MjModel) -> Array:
    """Return the speed (njnt,) that the controls of each joint's velocity actuators allow.

    It is the smaller one of the two directions.
    """
    speeds = np.full(model.njnt, np.inf)
    for actuator in _controlled(model, 2):
        joint, gear = model.actuator_trnid[actuator, 0], model.actuator_gear[actuator, 0]
        low, high = model.actuator_ctrlrange[actuator]
        if low < 0.0 < high:
            speeds[joint] = min(speeds[joint], min(-low, high) / abs(gear))
    return speeds


def _controlled(model: mujoco.MjModel, order: int) -> list[int]:
    """Return the actuators on hinges and slides whose force is k (u − x), with limited controls.

    x is the position for the order 1 and the velocity for the order 2, as the bias counts them.
    """
    return [
        actuator
        for actuator in servos(model)
        if model.actuator_ctrllimited[actuator]
        and model.actuator_gear[actuator, 0]
        and model.actuator_gainprm[actuator, 0] == -model.actuator_biasprm[actuator, order] > 0.0
        and not model.actuator_biasprm[actuator, :order].any()
    ]


def _coordinates(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the address in qpos of each dof that is a hinge or a slide, 0 for the others."""
    addresses = np.zeros(model.nv, dtype=np.intp)
    for joint in range(model.njnt):
        if joint_type(model, joint) not in (_FREE, _BALL):
            addresses[model.jnt_dofadr[joint]] = model.jnt_qposadr[joint]
    return addresses
