"""The `manipulability` task: the joints keep a frame away from its singularities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.configuration import QPOS_WIDTH, free_dofs, joint_type
from rmrc.model.frames import FrameHandle, resolve
from rmrc.tasks.base import Array, FieldError, GainedTask, Term
from rmrc.text.base import FrameName, NonNegative

if TYPE_CHECKING:
    from rmrc.problem.evaluation import Evaluation

Part = Literal["position", "orientation", "both"]

ROWS: dict[Part, slice] = {
    "position": slice(0, 3),
    "orientation": slice(3, 6),
    "both": slice(0, 6),
}
"""The rows of a Jacobian in the order [linear; angular]."""

# A singular value down to this share of the largest one is zero: rounding leaves about 1e-16.
SINGULAR = 1e-9
SAMPLES = 32
"""Configurations that a frame's generic rank and largest manipulability are found from."""

# The axes after and before x, y and z, in turn.
_AFTER, _BEFORE = np.array([1, 2, 0]), np.array([2, 0, 1])


class ManipulabilityTask(GainedTask):
    """Climb the manipulability w(q) = √det(J Jᵀ) of a frame.

    ẋ = K ∇w/w₀, where w₀ is the largest w found in the joint ranges: the shape of the arm decides,
    not its size, and the approach to the best configuration has a rate of the order of K. J has
    the columns of the joints that may move, without a floating base, which is left alone. ∇w is
    taken as zero at a singularity, where w has a kink and no direction out is better.

    Source: Yoshikawa 1985, Manipulability of robotic mechanisms.
    """

    type: Literal["manipulability"] = "manipulability"
    B: NonNegative = 1.0
    """Weight of the squared difference from the wanted joint rates, a number."""
    frame: FrameName
    """The frame that is to stay able to move."""
    part: Part = "position"
    """The rows of J: how the joints move the frame's origin, how they turn it, or both."""

    def claimed(self, model: mujoco.MjModel) -> list[int]:
        """Return the frame's body."""
        return [resolve(model, self.frame).body(model)]

    def compile(self, model: mujoco.MjModel, start: Array) -> "ManipulabilityTerm":
        """Resolve the frame and the joints that move it.

        Raises:
            FieldError: If no joint moves the frame, or none turns it and `part` is orientation.
        """
        handle = resolve(model, self.frame)
        dofs = joint_dofs_above(model, body_of(model, handle))
        named = f"the {handle.kind} '{self.frame.name}'"
        if not dofs.size:
            raise FieldError("frame", f"no joint moves {named}")
        if not Manipulability(model, start, handle, self.part, dofs).rank:
            raise FieldError("part", f"no joint changes the {self.part} of {named}")
        weight = np.zeros(model.nv)
        weight[dofs] = self.B
        return ManipulabilityTerm(
            **self.common(),
            weight=weight,
            target=start[:0],
            frame=handle,
            part=self.part,
            dofs=dofs,
        )


def body_of(model: mujoco.MjModel, frame: FrameHandle) -> int:
    """Return the body that a frame is fixed to."""
    if frame.kind == "body":
        return frame.id
    return int((model.site_bodyid if frame.kind == "site" else model.geom_bodyid)[frame.id])


def joint_dofs_above(model: mujoco.MjModel, body: int) -> NDArray[np.intp]:
    """Return the dofs that move a body, in the order of its chain, without a floating base's."""
    while body and not model.body_dofnum[body]:
        body = int(model.body_parentid[body])
    dof = int(model.body_dofadr[body] + model.body_dofnum[body] - 1) if body else -1
    found = []
    while dof >= 0:
        found.append(dof)
        dof = int(model.dof_parentid[dof])
    return np.setdiff1d(np.array(found, dtype=np.intp), free_dofs(model))


@dataclass(frozen=True, eq=False, kw_only=True)
class ManipulabilityTerm(Term):
    """A `manipulability` task: e = ∇w/w₀ on the joints that move the frame, J = I."""

    joint: ClassVar[bool] = True

    frame: FrameHandle
    part: Part
    dofs: NDArray[np.intp]

    @classmethod
    def evaluator(cls, terms: Sequence[Term], evaluation: "Evaluation") -> Callable[[], None]:
        """Evaluate the terms one by one, over the dofs that may move in this problem."""
        problem, data = evaluation.problem, evaluation.data
        entries = []
        for term in terms:
            assert isinstance(term, ManipulabilityTerm)
            dofs = np.intersect1d(term.dofs, problem.dofs)
            measure = Manipulability(problem.model, problem.start, term.frame, term.part, dofs)
            entries.append((evaluation.error[evaluation.rows_of([term])], dofs, measure))

        def evaluate() -> None:
            for error, dofs, measure in entries:
                error[dofs] = measure.gradient(data) / measure.largest

        return evaluate


class Manipulability:
    """The manipulability w of a frame over some dofs of its chain, and its gradient.

    w is the product of the r largest singular values of J, where r is the rank that J has at
    almost every configuration: √det(J Jᵀ) where r is the number of rows, √det(Jᵀ J) with fewer
    dofs than rows, and for a planar arm the area that it has in its plane.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        start: Array,
        frame: FrameHandle,
        part: Part,
        dofs: NDArray[np.intp],
    ):
        self._model, self._frame, self._rows, self._dofs = model, frame, ROWS[part], dofs
        self._world = np.zeros((6, model.nv))
        joints = model.dof_jntid[dofs]
        # [c, i]: whether dof i turns column c; the three of a ball joint turn one another.
        self._turns = (joints[:, None] >= joints).astype(float)
        self._sweeps = 1.0 - self._turns
        singular = self._survey(start)
        self.rank = int((singular > SINGULAR * singular[:, :1]).sum(axis=1).max())
        """r, the rank of J at almost every configuration."""
        self.largest = float(singular[:, : self.rank].prod(axis=1).max())
        """w₀, the largest w found."""

    def _survey(self, start: Array) -> Array:
        """Return the singular values (SAMPLES, ·) of J at configurations drawn from the ranges."""
        model, data, rng = self._model, mujoco.MjData(self._model), np.random.default_rng(0)
        rates, found = np.zeros(model.nv), []
        for _ in range(SAMPLES):
            rates[self._dofs] = rng.uniform(-np.pi, np.pi, self._dofs.size)
            data.qpos = start
            mujoco.mj_integratePos(model, data.qpos, rates, 1.0)
            for joint in np.unique(model.dof_jntid[self._dofs]):
                if model.jnt_limited[joint] and QPOS_WIDTH[joint_type(model, joint)] == 1:
                    data.qpos[model.jnt_qposadr[joint]] = rng.uniform(*model.jnt_range[joint])
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            found.append(np.linalg.svd(self._jacobian(data)[self._rows], compute_uv=False))
        return np.array(found)

    def _jacobian(self, data: mujoco.MjData) -> Array:
        """Return J (6, n) at the data's kinematics."""
        linear, angular = self._world[:3], self._world[3:]
        self._frame.jacobian(self._model, data, linear, angular, self._frame.id)
        return self._world[:, self._dofs]

    def gradient(self, data: mujoco.MjData) -> Array:
        """Return ∇w (n,) at the data's kinematics; zero at a singularity, where w has a kink.

        With J = U Σ Vᵀ it is ∂w/∂qᵢ = Σ_k (w/σ_k) u_kᵀ (∂J/∂qᵢ) v_k over the r largest σ_k, which
        is w tr((J Jᵀ)⁻¹ (∂J/∂qᵢ) Jᵀ) for full rank but without the squared condition number. It
        stays bounded towards a singularity, for w/σ_k is a product of the other singular values.

        A column c of J, the linear part p_c and the angular part ω_c, turns with every dof i at or
        before it: ∂p_c/∂qᵢ = ωᵢ × p_c and ∂ω_c/∂qᵢ = ωᵢ × ω_c. A dof after it moves the frame's
        origin alone: ∂p_c/∂qᵢ = ω_c × pᵢ (Hourtash 2005, The kinematic Hessian and higher
        derivatives).
        """
        r, jacobian = self.rank, self._jacobian(data)
        if not r:
            return np.zeros(self._dofs.size)
        u, sigma, vt = np.linalg.svd(jacobian[self._rows], full_matrices=False)
        if sigma[r - 1] <= SINGULAR * sigma[0]:
            return np.zeros(self._dofs.size)
        slope = np.zeros_like(jacobian)  # ∂w/∂J
        slope[self._rows] = (u[:, :r] * (sigma[:r].prod() / sigma[:r])) @ vt[:r]
        linear, angular = jacobian[:3], jacobian[3:]
        turned = _cross(linear, slope[:3]) + _cross(angular, slope[3:])
        swept = _cross(slope[:3], angular)
        return (angular * (turned @ self._turns) + linear * (swept @ self._sweeps)).sum(axis=0)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of the columns of two arrays (3, n)."""
    after, before = a.take(_AFTER, 0), a.take(_BEFORE, 0)
    return after * b.take(_BEFORE, 0) - before * b.take(_AFTER, 0)
