"""The actuators of a model that act on single joints, and those of them that are servos."""

import mujoco

from rmrc.model.configuration import joint_type

_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_ON_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
_DIRECT = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)


def joint_actuators(model: mujoco.MjModel) -> list[int]:
    """Return the actuators that act on a hinge or a slide."""
    return [
        actuator
        for actuator in range(model.nu)
        if mujoco.mjtTrn(int(model.actuator_trntype[actuator])) in _ON_JOINT
        and joint_type(model, int(model.actuator_trnid[actuator, 0])) in _SCALAR
    ]


def servos(model: mujoco.MjModel) -> list[int]:
    """Return those of them with the force F = g u + b₀ + b₁ l + b₂ l̇ of a control u."""
    return [
        actuator
        for actuator in joint_actuators(model)
        if mujoco.mjtGain(int(model.actuator_gaintype[actuator])) == mujoco.mjtGain.mjGAIN_FIXED
        and mujoco.mjtBias(int(model.actuator_biastype[actuator])) == mujoco.mjtBias.mjBIAS_AFFINE
        and mujoco.mjtDyn(int(model.actuator_dyntype[actuator])) in _DIRECT
    ]
