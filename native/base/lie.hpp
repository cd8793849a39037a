// Rotations and rigid motions: what the errors of poses are made of.
#pragma once

#include <cmath>

namespace rmrc {

// Vectors (3,), matrices (3, 3) by rows, quaternions wxyz, twists (6,): linear, then angular.

inline double dot3(const double* a, const double* b) noexcept {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

inline double norm3(const double* v) noexcept { return std::sqrt(dot3(v, v)); }

inline void cross(const double* a, const double* b, double* out) noexcept {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

/// out = R v.
void rotate(const double* R, const double* v, double* out) noexcept;

/// out = Rᵀv.
void rotate_back(const double* R, const double* v, double* out) noexcept;

/// out = A B.
void multiply3(const double* A, const double* B, double* out) noexcept;

/// out = A Bᵀ.
void multiply_transposed3(const double* A, const double* B, double* out) noexcept;

/// out = AᵀB.
void transposed_multiply3(const double* A, const double* B, double* out) noexcept;

/// The rotation matrix of a unit quaternion.
void matrix_of(const double* quaternion, double* R) noexcept;

/// The unit quaternion of a rotation matrix.
void quaternion_of(const double* R, double* quaternion) noexcept;

/// out = a* b, with a* the conjugate of a.
void conjugate_multiply(const double* a, const double* b, double* out) noexcept;

/// out = a b*.
void multiply_conjugate(const double* a, const double* b, double* out) noexcept;

/// ω with exp(ω) the rotation of a unit quaternion, ‖ω‖ ≤ π.
void log_rotation(const double* quaternion, double* omega) noexcept;

/// e = log(T) of the motion T with this rotation and translation.
void log_motion(const double* quaternion, const double* translation, double* twist) noexcept;

/// A = Jl⁻¹(ω), the inverse of the left Jacobian of SO(3); Jr⁻¹(ω) is its transpose.
void inverse_left_jacobian(const double* omega, double* A) noexcept;

/// The two blocks of the inverse of the left Jacobian of SE(3) at a twist, [A B; 0 A].
///
/// With e = −log(T) they are those of Jlog(T), T's rate in its own axes to that of its logarithm.
void inverse_left_jacobian_motion(const double* twist, double* A, double* B) noexcept;

}  // namespace rmrc
