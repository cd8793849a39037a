"""SE(3) on bare arrays (7,) in the layout wxyz + xyz: mink's compiled operations.

mink's tasks use these themselves. Where mink was built without its extension, its classes
give the same results more slowly; a test holds the two equal.
"""

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


def turn_back(pose: Array, twist: Array) -> Array:
    """Return a twist (6,) in the axes of a pose, from those of the frame that the pose is in."""
    turned, conjugate = np.empty(6), np.empty(4)
    mujoco.mju_negQuat(conjugate, pose[:4])
    mujoco.mju_rotVecQuat(turned[:3], twist[:3], conjugate)
    mujoco.mju_rotVecQuat(turned[3:], twist[3:], conjugate)
    return turned
