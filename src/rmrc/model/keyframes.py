"""Keyframes by the names of what they place, so that they outlive what is attached."""

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from rmrc.model.repair import depth_first

_WIDTHS = {
    mujoco.mjtJoint.mjJNT_FREE: (7, 6),
    mujoco.mjtJoint.mjJNT_BALL: (4, 3),
    mujoco.mjtJoint.mjJNT_SLIDE: (1, 1),
    mujoco.mjtJoint.mjJNT_HINGE: (1, 1),
}
HOME = "home"


@dataclass
class Keyframe:
    """What a keyframe says of joints, actuators and mocap bodies, each by name."""

    name: str
    time: float = 0.0
    qpos: dict[str, Any] = field(default_factory=dict)
    qvel: dict[str, Any] = field(default_factory=dict)
    ctrl: dict[str, float] = field(default_factory=dict)
    mocap: dict[str, tuple[Any, Any]] = field(default_factory=dict)

    def named(self, prefix: str) -> "Keyframe":
        """Return the same of things whose names begin with a prefix."""

        def longer(part: dict[str, Any]) -> dict[str, Any]:
            return {f"{prefix}{name}": value for name, value in part.items()}

        parts = (longer(self.qpos), longer(self.qvel), longer(self.ctrl), longer(self.mocap))
        return Keyframe(self.name, self.time, *parts)

    def write(self, model: mujoco.MjModel, key: int) -> None:
        """Write it into a keyframe of a compiled model, over what is there."""
        for name, value in self.qpos.items():
            first = int(model.joint(name).qposadr[0])
            model.key_qpos[key, first : first + len(value)] = value
        for name, value in self.qvel.items():
            first = int(model.joint(name).dofadr[0])
            model.key_qvel[key, first : first + len(value)] = value
        for name, value in self.ctrl.items():
            model.key_ctrl[key, model.actuator(name).id] = value
        for name, (position, quaternion) in self.mocap.items():
            mocap = int(model.body(name).mocapid[0])
            model.key_mpos[key, 3 * mocap : 3 * mocap + 3] = position
            model.key_mquat[key, 4 * mocap : 4 * mocap + 4] = quaternion


def take_keyframes(spec: mujoco.MjSpec) -> list[Keyframe]:
    """Take the keyframes out of a spec, whose joints, bodies and actuators all have names."""
    bodies = list(depth_first(spec))
    joints = [joint for body in bodies for joint in body.joints]
    mocaps = [body.name for body in bodies if body.mocap]
    actuators = [actuator.name for actuator in spec.actuators]
    found = []
    for key in list(spec.keys):
        kept = Keyframe(key.name, float(key.time))
        qpos, qvel = np.array(key.qpos, dtype=float), np.array(key.qvel, dtype=float)
        kept.qpos = _split(joints, qpos, 0)
        kept.qvel = _split(joints, qvel, 1)
        ctrl = np.array(key.ctrl, dtype=float)
        if ctrl.size == len(actuators):
            kept.ctrl = dict(zip(actuators, ctrl.tolist(), strict=True))
        places, turns = np.array(key.mpos, dtype=float), np.array(key.mquat, dtype=float)
        if places.size == 3 * len(mocaps) and turns.size == 4 * len(mocaps):
            poses = zip(places.reshape(-1, 3), turns.reshape(-1, 4), strict=True)
            kept.mocap = dict(zip(mocaps, poses, strict=True))
        found.append(kept)
        spec.delete(key)
    return found


def home_of(keyframes: list[Keyframe]) -> Keyframe | None:
    """Return the keyframe that a robot starts in: `home`, else the only one."""
    named = [key for key in keyframes if key.name == HOME]
    return (named or (keyframes if len(keyframes) == 1 else [None]))[0]


def _split(joints: list[Any], numbers: Any, kind: int) -> dict[str, Any]:
    """Return the numbers of each joint: coordinates for the kind 0, rates for 1."""
    widths = [_WIDTHS[joint.type][kind] for joint in joints]
    if numbers.size != sum(widths):
        return {}
    ends = np.cumsum([0, *widths])
    return {
        joint.name: numbers[first:last]
        for joint, first, last in zip(joints, ends, ends[1:], strict=False)
    }
