"""Joint controllers: what turns the joints' set points into forces in MuJoCo's physics."""

import math
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.actuators import joint_actuators, servos
from rmrc.model.configuration import joint_dofs

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class JointControl(Protocol):
    """Drives the joints to set points; it knows their true state, as a drive's own loop does."""

    def drive(self, data: mujoco.MjData, q: Array, v: Array) -> None:
        """Set the forces for one step of the physics, after `mj_step1`.

        Args:
            data: State of the physics.
            q: Set points (nq,), rad or m.
            v: Their velocities (nv,), rad/s or m/s.
        """
        ...

    def reach(self, data: mujoco.MjData) -> Array:
        """Return how far a set point can lead its joint before the force saturates (nv,)."""
        ...


class PositionServos:
    """The model's own position actuators, F = g u + b₀ + b₁ l + b₂ l̇ with b₁ < 0 < g.

    The control u is the one that gives no force on the set point's motion (l_d, l̇_d), so that
    F = −b₁ (l_d − l) − b₂ (l̇_d − l̇): with u = l_d alone, the damping would make the joint lag by
    b₂/b₁ seconds.
    """

    def __init__(self, model: mujoco.MjModel):
        servos = _position_servos(model)
        joints = model.actuator_trnid[servos, 0]
        self._servos = np.array(servos, dtype=np.intp)
        self._dof = model.jnt_dofadr[joints]
        self._coordinate = model.jnt_qposadr[joints]
        self._gear = model.actuator_gear[servos, 0]
        self._gain = model.actuator_gainprm[servos, 0]
        self._bias = model.actuator_biasprm[servos, :3].T.copy()
        stiffness = np.zeros(model.nv)
        np.add.at(stiffness, self._dof, -self._bias[1] * self._gear**2)
        self._reach = _quotient(torque_limits(model), stiffness)

    def drive(self, data: mujoco.MjData, q: Array, v: Array) -> None:
        """Set the actuators' controls."""
        constant, position, velocity = self._bias
        length, rate = self._gear * q[self._coordinate], self._gear * v[self._dof]
        force = constant + position * length + velocity * rate
        data.ctrl[self._servos] = -force / self._gain

    def reach(self, data: mujoco.MjData) -> Array:
        """Return the torque limit over the stiffness (nv,)."""
        return self._reach


class ComputedTorque:
    """Torques τ = M(q)(ω² (q_d ⊖ q) + 2ζω (q̇_d − q̇)) + c(q, q̇) − τ_passive.

    Every joint's error then decays with the bandwidth ω and the damping ratio ζ, whatever the
    pose (Luh, Walker and Paul, *Resolved-acceleration control of mechanical manipulators*, 1980).
    c holds gravity, Coriolis and centrifugal forces, τ_passive springs, dampers and the gravity
    compensation that the model has already. The torques keep the limits that the model gives to
    the joint or to its actuators, which they replace.

    Args:
        model: A model of one's own; its actuators on the driven joints are switched off.
        dofs: The dofs that may move; joints with an actuator are held too.
        bandwidth: ω, rad/s.
        damping_ratio: ζ.
    """

    def __init__(
        self, model: mujoco.MjModel, dofs: Indices, bandwidth: float, damping_ratio: float
    ):
        self._model = model
        self._stiffness, self._damping = bandwidth**2, 2.0 * damping_ratio * bandwidth
        self._limit = torque_limits(model)
        actuators = joint_actuators(model)
        held = [joint_dofs(model, int(model.actuator_trnid[a, 0])) for a in actuators]
        self._idle = np.ones(model.nv, dtype=bool)
        self._idle[np.concatenate([dofs, *held])] = False
        model.actuator_gainprm[actuators] = 0.0
        model.actuator_biasprm[actuators] = 0.0
        model.jnt_actgravcomp[:] = 0  # what the actuators compensated becomes passive
        self._acceleration, self._torque = np.empty(model.nv), np.empty(model.nv)

    def drive(self, data: mujoco.MjData, q: Array, v: Array) -> None:
        """Set the torques."""
        acceleration, torque = self._acceleration, self._torque
        mujoco.mj_differentiatePos(self._model, acceleration, 1.0, data.qpos, q)
        acceleration *= self._stiffness
        acceleration += self._damping * (v - data.qvel)
        acceleration[self._idle] = 0.0
        mujoco.mj_mulM(self._model, data, torque, acceleration)
        torque += data.qfrc_bias - data.qfrc_passive
        torque[self._idle] = 0.0
        np.clip(torque, -self._limit, self._limit, out=data.qfrc_applied)

    def reach(self, data: mujoco.MjData) -> Array:
        """Return the torque limit over the stiffness ω² M_ii (nv,)."""
        inertia = data.M[self._model.M_rowadr + self._model.M_rownnz - 1]
        return _quotient(self._limit, self._stiffness * inertia)


def without_servo(model: mujoco.MjModel, dofs: Indices) -> list[str]:
    """Return the names of the joints of some dofs that have no position actuator."""
    driven = model.jnt_dofadr[model.actuator_trnid[_position_servos(model), 0]]
    joints = dict.fromkeys(int(model.dof_jntid[dof]) for dof in np.setdiff1d(dofs, driven))
    return [model.joint(joint).name or f"joint {joint}" for joint in joints]


def highest_bandwidth(damping_ratio: float, timestep: float) -> float:
    """Return the ω in rad/s up to which `ComputedTorque` is stable in steps of h seconds.

    The error follows ẇ = −ω² e − 2ζω w, ė = w in semi-implicit Euler steps, whose eigenvalues are
    inside the unit circle while ωh (ωh + 4ζ) < 4.
    """
    return 2.0 * (math.hypot(1.0, damping_ratio) - damping_ratio) / timestep


def torque_limits(model: mujoco.MjModel) -> Array:
    """Return the largest torque or force of each dof (nv,), N·m or N, infinite without a limit.

    It is what the joint's actuators can give together, within the joint's own limit.
    """
    given = np.zeros(model.nv)
    for actuator in joint_actuators(model):
        limited = model.actuator_forcelimited[actuator]
        largest = np.abs(model.actuator_forcerange[actuator]).max() if limited else np.inf
        dof = model.jnt_dofadr[model.actuator_trnid[actuator, 0]]
        given[dof] += largest * abs(model.actuator_gear[actuator, 0])
    limit = np.where(given > 0.0, given, np.inf)
    for joint in np.flatnonzero(model.jnt_actfrclimited):
        dofs = joint_dofs(model, int(joint))
        limit[dofs] = np.minimum(limit[dofs], np.abs(model.jnt_actfrcrange[joint]).max())
    return limit


def _position_servos(model: mujoco.MjModel) -> list[int]:
    """Return the actuators on joints whose force pulls towards the control."""
    gain, position = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1]
    return [actuator for actuator in servos(model) if gain[actuator] > 0.0 > position[actuator]]


def _quotient(limit: Array, stiffness: Array) -> Array:
    """Return limit / stiffness, infinite where either says so."""
    return np.divide(limit, stiffness, out=np.full_like(limit, np.inf), where=stiffness > 0.0)
