"""The `frame` task: the pose of a site, body or geom follows a target pose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ValidationInfo, field_validator

from rmrc.model.frames import FrameHandle, resolve
from rmrc.model.lie import inverse_left_jacobian, inverse_multiply, log_motion, pose_of
from rmrc.tasks.base import (
    Array,
    BendingTerm,
    GainedTask,
    HardTask,
    Preserve,
    Pull,
    TargetKind,
    Term,
    Way,
    weight_array,
)
from rmrc.text.base import FrameName, Model, Positive, Weight

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation


def _block_weight(weight: object) -> object:
    if isinstance(weight, tuple):
        raise ValueError("give a number here; a full diagonal or matrix goes into B itself")
    return weight


BlockWeight = Annotated[Weight, AfterValidator(_block_weight)]


class PoseWeight(Model):
    """Weights of the two halves of a pose error."""

    position: BlockWeight = 1.0
    """Weight of the squared position error, 1/m²."""
    orientation: BlockWeight = 1.0
    """Weight of the squared orientation error, 1/rad²."""


class PoseClamp(Model):
    """Largest error that a pose task acts on; what is beyond is approached at constant speed."""

    position: Positive | None = None
    """m."""
    orientation: Positive | None = None
    """rad."""


class PoseTask(HardTask, GainedTask):
    """What the tasks on poses share."""

    target_kind: ClassVar[TargetKind] = "pose"

    B: PoseWeight | Weight = PoseWeight()
    """Weight in the order [position; orientation], or {position: …, orientation: …}."""
    clamp: PoseClamp = PoseClamp()
    """Largest error that the task acts on."""
    preserve: Preserve | None = None
    """`direction`: move along ẋ as fast as the limits allow, not as near to it as may be."""

    @field_validator("preserve")
    @classmethod
    def _no_constraint(cls, preserve: Preserve | None, others: ValidationInfo) -> Preserve | None:
        if preserve and others.data.get("hard"):
            raise ValueError("a hard task has no cost to replace: it moves as ẋ says")
        return preserve

    def pose_weight(self) -> Array:
        """Return B as (6,) or (6, 6).

        Raises:
            FieldError: If B has another size.
        """
        if isinstance(self.B, PoseWeight):
            halves = np.array([self.B.position, self.B.orientation], dtype=float)
            return np.repeat(halves, 3)
        return weight_array(self.B, 6)


class FrameTask(PoseTask):
    """Bring a frame to a target pose in the world."""

    type: Literal["frame"] = "frame"
    frame: FrameName
    """The frame that moves."""
    axes: Literal["body", "world"] = "body"
    """The axes of the error and of B: the frame's own, or the world's."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the frame's body."""
        return [resolve(model, self.frame).body(model)]

    def compile(self, model: mujoco.MjModel, start: Array) -> "FrameTerm":
        """Resolve the frame; the target is its pose at the start."""
        weight = self.pose_weight()
        handle = resolve(model, self.frame)
        return FrameTerm(
            **self.common(),
            weight=weight,
            target=handle.pose_at(model, start),
            frame=handle,
            axes=self.axes,
            clamp=(self.clamp.position or np.inf, self.clamp.orientation or np.inf),
            preserve=self.preserve is not None,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseTerm(BendingTerm):
    """What the terms on poses share: targets (7,) as wxyz + xyz, errors as a twist."""

    target_kind: ClassVar[TargetKind] = "pose"
    decisive: ClassVar[bool] = True

    clamp: tuple[float, float]
    """Largest error that the task acts on, m and rad; infinite without one."""

    @property
    def clamps(self) -> tuple[tuple[slice, float], ...]:
        """The position and the orientation, each where it has a clamp."""
        halves = zip((slice(3), slice(3, 6)), self.clamp, strict=True)
        return tuple((half, longest) for half, longest in halves if longest < np.inf)

    @cached_property
    def weighed(self) -> tuple[bool, bool]:
        """Whether the position and the orientation have a weight."""
        return (bool(self.diagonal[:3].any()), bool(self.diagonal[3:].any()))

    @property
    def units(self) -> tuple[str, ...]:
        """The distance and the angle, each where it has a weight."""
        return tuple(compress(("m", "rad"), self.weighed))

    @property
    def unit_rows(self) -> tuple[NDArray[np.intp], ...]:
        """Those of the position and those of the orientation."""
        return tuple(compress(np.arange(6).reshape(2, 3), self.weighed))

    def measure(self, error: Array) -> Array:
        """Return the distance in m and the angle in rad, each where it has a weight."""
        return self.distances(error)[list(self.weighed)]

    def distances(self, error: Array) -> Array:
        """Return the distance in m and the angle in rad that the logarithm e = log(T) stands for.

        The logarithm's first three numbers are not the distance: it is ‖V(ω) ρ‖, with
        ‖V ρ‖² = (ρ·n)² + (2 sin(θ/2)/θ)² (‖ρ‖² − (ρ·n)²) for the axis n and the angle θ of ω.
        """
        rho, omega = error[:3], error[3:6]
        angle = float(np.sqrt(omega @ omega))
        length = float(rho @ rho)
        if angle < 1e-9:
            return np.array([np.sqrt(length), angle])
        along = float(rho @ omega / angle) ** 2
        chord = (2.0 * np.sin(0.5 * angle) / angle) ** 2
        return np.array([np.sqrt(along + chord * max(length - along, 0.0)), angle])


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameTerm(PoseTerm):
    """Rows of a `frame` task for the frame b and the target t.

    Along the body's axes e = log(T_bt) = −log(T_tb) and J = Jl⁻¹(e) J_b, which is mink's
    FrameTask with both signs turned. Along the world's e = [p_t − p_b; φ] with φ = log(R_t R_bᵀ),
    and J = [J_p; Jr⁻¹(φ) J_ω].
    """

    frame: FrameHandle
    axes: Literal["body", "world"]

    def way(self, model: mujoco.MjModel) -> Way:
        """Return the dofs on the way to the frame."""
        return Way.chain(self.frame.dofs(model))

    def pull(self, evaluation: "Evaluation", pulled: Array) -> Pull:
        """Return the force and the torque of [position; orientation] at the frame's origin."""
        position, matrix = self.frame.views(evaluation.data)
        target, pose = evaluation.target[self.name], np.array(pose_of(matrix, position))
        velocities = self.frame.velocities(evaluation.model, evaluation.data)
        if self.axes == "world":
            error, angular = np.zeros(6), np.zeros((3, 3))
            _world_error(target, pose, error, angular)
            return Pull(*velocities, pulled[:3], angular.T @ pulled[3:])
        error = log_motion(inverse_multiply(pose, target))
        wrench = inverse_left_jacobian(error).T @ pulled
        rotation = matrix.reshape(3, 3)
        return Pull(*velocities, rotation @ wrench[:3], rotation @ wrench[3:])

    def distances(self, error: Array) -> Array:
        """Return the distance in m and the angle in rad."""
        if self.axes == "body":
            return super().distances(error)
        return np.sqrt([error[:3] @ error[:3], error[3:6] @ error[3:6]])

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate all frames together: one matrix product turns their Jacobians at once."""
        return _FrameEvaluator([t for t in terms if isinstance(t, FrameTerm)], evaluation)


class _FrameEvaluator:
    """Evaluates every `frame` term: poses one by one, the products with the Jacobians stacked."""

    def __init__(self, terms: Sequence[FrameTerm], evaluation: "Evaluation"):
        count, nv = len(terms), evaluation.model.nv
        rows = evaluation.rows_of(terms)
        self._model, self._data = evaluation.model, evaluation.data
        self._moving = evaluation.moving
        self._world = np.zeros((count, 6, nv))  # J in the world's axes
        self._transform = np.tile(np.eye(6), (count, 1, 1))  # what turns it into the error's rate
        self._jacobian = evaluation.jacobian[rows].reshape(count, 6, nv)
        self._error = evaluation.error[rows].reshape(count, 6)
        self._feedforward = evaluation.feedforward[rows].reshape(count, 6)
        self._body, self._in_world = [], []
        for k, term in enumerate(terms):
            position, matrix = term.frame.views(self._data)
            shared = (
                term.frame.jacobian,
                term.frame.id,
                self._world[k, :3],
                self._world[k, 3:],
                matrix,
                position,
                evaluation.target[term.name],
                self._error[k],
            )
            if term.axes == "world":
                self._in_world.append((*shared, self._transform[k, 3:, 3:]))
            else:
                halves = self._transform[k].reshape(12, 3)
                self._body.append((*shared, matrix.reshape(3, 3).T, halves))
        self._feeds = [
            (
                k,
                evaluation.index[t.name],
                t,
                evaluation.target[t.name],
                evaluation.twist[t.name],
                t.frame.views(self._data)[0],
                evaluation.carrier(t.frame.body(self._model)),
            )
            for k, t in enumerate(terms)
        ]
        self._carried = any(carrier is not None for *_, carrier in self._feeds)

    def __call__(self) -> None:
        model, data = self._model, self._data
        for jac, i, jp, jr, matrix, position, target, error, turned, halves in self._body:
            jac(model, data, jp, jr, i)
            pose = pose_of(matrix, position)
            error[:] = log_motion(inverse_multiply(pose, target))
            # Jl⁻¹ diag(Rᵀ, Rᵀ): each half of a row of Jl⁻¹ is turned by Rᵀ.
            inverse_left_jacobian(error).reshape(12, 3).dot(turned, halves)
        for jac, i, jp, jr, matrix, position, target, error, angular in self._in_world:
            jac(model, data, jp, jr, i)
            _world_error(target, pose_of(matrix, position), error, angular)
        if len(self._world) == 1:  # `dot` takes half the time of a `matmul` this small
            self._transform[0].dot(self._world[0], self._jacobian[0])
        else:
            np.matmul(self._transform, self._world, out=self._jacobian)
        if self._carried or 1 in self._moving:
            self._feed_forward()

    def _feed_forward(self) -> None:
        """Write what the target's own velocity (v_t, ω_t) adds, less what a mocap body does.

        Along the body's axes it is what the frame would have to do to move with the target as one
        rigid body, (v_t + ω_t × (p_b − p_t), ω_t). Along the world's it is [v_t; Jl⁻¹(φ) ω_t],
        where Jl⁻¹(φ) is the transpose of Jr⁻¹(φ). A mocap body moves the frame as joints would.
        """
        for k, index, term, target, twist, position, carrier in self._feeds:
            if not self._moving[index]:
                self._feedforward[k] = 0.0
            elif term.axes == "world":
                self._feedforward[k] = self._transform[k].T @ twist
            else:
                rigid = twist.copy()
                rigid[:3] += np.cross(twist[3:], position - target[4:])
                self._feedforward[k] = self._transform[k] @ rigid
            if carrier is not None:
                self._feedforward[k] -= self._transform[k] @ carrier.velocity(position)


def _world_error(target: Array, pose: Array, error: Array, angular: Array) -> None:
    """Write e = [p_t − p_b; φ] and Jr⁻¹(φ) for the rotation φ = log(R_t R_bᵀ)."""
    np.subtract(target[4:], pose[4:], out=error[:3])
    turn = np.zeros(7)
    mujoco.mju_negQuat(turn[:4], pose[:4])
    mujoco.mju_mulQuat(turn[:4], target[:4], turn[:4].copy())
    mujoco.mju_quat2Vel(error[3:], turn[:4], 1.0)
    # Jr⁻¹(φ) = Jl⁻¹(−φ)
    angular[:] = inverse_left_jacobian(np.concatenate([np.zeros(3), -error[3:]]))[3:, 3:]
