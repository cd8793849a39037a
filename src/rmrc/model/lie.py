"""SE(3) on bare arrays (7,) in the layout wxyz + xyz: mink's compiled operations.

mink's tasks use these themselves. Where mink was built without its extension, its classes
give the same results more slowly; a test holds the two equal.
"""

import math

import mujoco
import numpy as np
from mink import SE3, SO3
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _rminus(a: Array, b: Array) -> Array:
    return SE3(a).rminus(SE3(b))


def _jlog(a: Array) -> Array:
    return SE3(a).jlog()


def _inverse(a: Array) -> Array:
    return SE3(a).inverse().wxyz_xyz


def _inverse_multiply(a: Array, b: Array) -> Array:
    return (SE3(a).inverse() @ SE3(b)).wxyz_xyz


def _adjoint(a: Array) -> Array:
    return SE3(a).adjoint()


def _pose_of(matrix: Array, position: Array) -> Array:
    rotation = SO3.from_matrix(matrix.reshape(3, 3))
    return SE3.from_rotation_and_translation(rotation, position).wxyz_xyz


try:
    from mink.lie import _lie_ops_c as _compiled
except ImportError:
    rminus, jlog, inverse = _rminus, _jlog, _inverse
    inverse_multiply, adjoint, pose_of = _inverse_multiply, _adjoint, _pose_of
else:
    rminus = _compiled.se3_rminus
    """log(b⁻¹ a) of two poses, a twist (6,): linear, then angular."""
    jlog = _compiled.se3_jlog
    """Jacobian (6, 6) of the logarithm at a pose."""
    inverse = _compiled.se3_inverse
    """Inverse of a pose."""
    inverse_multiply = _compiled.se3_inverse_multiply
    """a⁻¹ b of two poses."""
    adjoint = _compiled.se3_adjoint
    """Adjoint (6, 6) of a pose, acting on twists."""
    pose_of = _compiled.xmat_xpos_to_wxyz_xyz
    """Pose of a rotation matrix (9,) and a position (3,)."""


# Up to this angle, rad, closed forms lose digits and series of six terms have them all.
_SMALL = 0.5


def log_motion(pose: Array) -> Array:
    """Return log(T) (6,) of a pose T: ρ = V⁻¹(ω) t = t − ½ ω×t + c ω×(ω×t), and ω, ‖ω‖ ≤ π.

    mink's own leaves out ½ ω×t for θ below 1e-5 rad, and is zero at half a turn without its
    extension.
    """
    omega, translation = np.empty(3), pose[4:]
    mujoco.mju_quat2Vel(omega, pose[:4], 1.0)
    once = np.cross(omega, translation)
    c, _ = _bend(float(omega @ omega))
    return np.concatenate([translation - 0.5 * once + c * np.cross(omega, once), omega])


def inverse_left_jacobian(twist: Array) -> Array:
    """Return Jl⁻¹ (6, 6) at a twist (ρ, ω): what turns a motion of T into the rate of log(T).

    Jl⁻¹ = [A B; 0 A] with A = I − ½Ω + c Ω², c = (1 − ½θ cot ½θ)/θ², for the matrices Ω and P of
    the cross products with ω and ρ. B is the derivative of A along ρ, since both are one power
    series, of the adjoint [Ω P; 0 Ω] as of Ω: B = −½P + c (ΩP + PΩ) + c′/θ (ω·ρ) Ω². At an error
    e = log(T_bt) it is mink's `jlog` of T_tb, which is the identity for θ² below rounding and loses
    digits below 1e-3 rad; this one is exact at every θ from 0 to π.

    Source: Barfoot, State Estimation for Robotics, 2017, section 7.1.5, for A and the blocks.
    """
    rho, omega = twist[:3], twist[3:]
    c, slope = _bend(float(omega @ omega))
    p, w = _cross_matrix(rho), _cross_matrix(omega)
    square = w @ w
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = np.eye(3) - 0.5 * w + c * square
    jacobian[:3, 3:] = -0.5 * p + c * (w @ p + p @ w) + slope * float(omega @ rho) * square
    return jacobian


def _bend(square: float) -> tuple[float, float]:
    """Return c(θ) = (1 − ½θ cot ½θ)/θ² and c′(θ)/θ, for θ²."""
    if square < _SMALL * _SMALL:
        # c = Σ |B_2k| θ^(2k−2)/(2k)!, with Bernoulli's numbers.
        c, slope = 0.0, 0.0
        for k, coefficient in reversed(list(enumerate(_SERIES))):
            c = coefficient + square * c
            slope = 2.0 * k * coefficient + square * slope if k else slope
        return c, slope
    theta = math.sqrt(square)
    half = 0.5 * theta
    sine, cosine = math.sin(half), math.cos(half)
    c = (1.0 - half * cosine / sine) / square
    slope = (half * cosine / sine + half * half / (sine * sine) - 2.0) / (square * square)
    return c, slope


_SERIES = (
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30240.0,
    1.0 / 1209600.0,
    1.0 / 47900160.0,
    691.0 / 1307674368000.0,
)


def _cross_matrix(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turn_back(pose: Array, twist: Array) -> Array:
    """Return a twist (6,) in the axes of a pose, from those of the frame that the pose is in."""
    turned, conjugate = np.empty(6), np.empty(4)
    mujoco.mju_negQuat(conjugate, pose[:4])
    mujoco.mju_rotVecQuat(turned[:3], twist[:3], conjugate)
    mujoco.mju_rotVecQuat(turned[3:], twist[3:], conjugate)
    return turned
