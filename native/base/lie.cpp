#include "base/lie.hpp"

#include <algorithm>
#include <cmath>

namespace rmrc {

namespace {

// Up to this angle, rad, closed forms lose digits and six terms of a series have them all:
// rmrc.model.lie.
constexpr double small = 0.5;

// c(θ) = (1 − ½θ cot ½θ)/θ² and c′(θ)/θ.
struct Bend {
  explicit Bend(double square) noexcept {
    if (square < small * small) {
      constexpr double series[] = {1.0 / 12.0,      1.0 / 720.0,      1.0 / 30240.0,
                                   1.0 / 1209600.0, 1.0 / 47900160.0, 691.0 / 1307674368000.0};
      c = slope = 0.0;
      for (int k = 5; k > 0; --k) {
        c = series[k] + square * c;
        slope = 2.0 * k * series[k] + square * slope;
      }
      c = series[0] + square * c;
      return;
    }
    const double half = 0.5 * std::sqrt(square), sine = std::sin(half);
    const double cotangent = half * std::cos(half) / sine;
    c = (1.0 - cotangent) / square;
    slope = (cotangent + half * half / (sine * sine) - 2.0) / (square * square);
  }

  double c, slope;
};

// out ← out + factor [v]×
void add_cross(double factor, const double* v, double* out) noexcept {
  out[1] -= factor * v[2];
  out[2] += factor * v[1];
  out[3] += factor * v[2];
  out[5] -= factor * v[0];
  out[6] -= factor * v[1];
  out[7] += factor * v[0];
}

// A = I − ½Ω + c Ω², with Ω² = ωωᵀ − θ²I.
void inverse_left_jacobian(const double* omega, double square, double c, double* A) noexcept {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) A[3 * i + j] = c * omega[i] * omega[j];
    A[4 * i] += 1.0 - c * square;
  }
  add_cross(-0.5, omega, A);
}

}  // namespace

void rotate(const double* R, const double* v, double* out) noexcept {
  for (int i = 0; i < 3; ++i) out[i] = dot3(R + 3 * i, v);
}

void rotate_back(const double* R, const double* v, double* out) noexcept {
  for (int i = 0; i < 3; ++i) out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

void multiply3(const double* A, const double* B, double* out) noexcept {
  for (int i = 0; i < 3; ++i) {
    const double a = A[3 * i], b = A[3 * i + 1], c = A[3 * i + 2];
    for (int j = 0; j < 3; ++j) out[3 * i + j] = a * B[j] + b * B[3 + j] + c * B[6 + j];
  }
}

void multiply_transposed3(const double* A, const double* B, double* out) noexcept {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[3 * i + j] = dot3(A + 3 * i, B + 3 * j);
  }
}

void transposed_multiply3(const double* A, const double* B, double* out) noexcept {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      out[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
    }
  }
}

void matrix_of(const double* quaternion, double* R) noexcept {
  const double w = quaternion[0], x = quaternion[1], y = quaternion[2], z = quaternion[3];
  R[0] = 1.0 - 2.0 * (y * y + z * z);
  R[1] = 2.0 * (x * y - w * z);
  R[2] = 2.0 * (x * z + w * y);
  R[3] = 2.0 * (x * y + w * z);
  R[4] = 1.0 - 2.0 * (x * x + z * z);
  R[5] = 2.0 * (y * z - w * x);
  R[6] = 2.0 * (x * z - w * y);
  R[7] = 2.0 * (y * z + w * x);
  R[8] = 1.0 - 2.0 * (x * x + y * y);
}

void quaternion_of(const double* R, double* quaternion) noexcept {
  // 4w², 4x², 4y², 4z²: the root of the largest loses no digits, and the others follow from it.
  const double trace = R[0] + R[4] + R[8];
  const double squares[4] = {trace + 1.0, 1.0 + R[0] - R[4] - R[8], 1.0 + R[4] - R[0] - R[8],
                             1.0 + R[8] - R[0] - R[4]};
  const double wx = R[7] - R[5], wy = R[2] - R[6], wz = R[3] - R[1];
  const double xy = R[1] + R[3], xz = R[2] + R[6], yz = R[5] + R[7];
  const double products[4][4] = {{0.0, wx, wy, wz}, {wx, 0.0, xy, xz}, {wy, xy, 0.0, yz},
                                 {wz, xz, yz, 0.0}};
  const auto largest = std::max_element(squares + 1, squares + 4) - squares;
  const int k = trace > 0.0 ? 0 : static_cast<int>(largest);
  const double twice = 2.0 * std::sqrt(squares[k]);
  for (int i = 0; i < 4; ++i) quaternion[i] = products[k][i] / twice;
  quaternion[k] = 0.25 * twice;
  double square = 0.0;
  for (int i = 0; i < 4; ++i) square += quaternion[i] * quaternion[i];
  const double scale = 1.0 / std::sqrt(square);
  for (int i = 0; i < 4; ++i) quaternion[i] *= scale;
}

void conjugate_multiply(const double* a, const double* b, double* out) noexcept {
  out[0] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  out[1] = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2];
  out[2] = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1];
  out[3] = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0];
}

void multiply_conjugate(const double* a, const double* b, double* out) noexcept {
  out[0] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  out[1] = -a[0] * b[1] + a[1] * b[0] - a[2] * b[3] + a[3] * b[2];
  out[2] = -a[0] * b[2] + a[1] * b[3] + a[2] * b[0] - a[3] * b[1];
  out[3] = -a[0] * b[3] - a[1] * b[2] + a[2] * b[1] + a[3] * b[0];
}

void log_rotation(const double* quaternion, double* omega) noexcept {
  const double sine = std::sqrt(dot3(quaternion + 1, quaternion + 1));
  const double w = quaternion[0];
  double scale = 0.0;
  if (sine > 0.0) {
    // Of the two quaternions of the rotation, the one with w ≥ 0.
    scale = std::copysign(2.0 * std::atan2(sine, std::abs(w)) / sine, w < 0.0 ? -1.0 : 1.0);
  }
  for (int i = 0; i < 3; ++i) omega[i] = scale * quaternion[1 + i];
}

void log_motion(const double* quaternion, const double* translation, double* twist) noexcept {
  double* omega = twist + 3;
  log_rotation(quaternion, omega);
  const Bend bend(dot3(omega, omega));
  // V⁻¹t = t − ½ ω×t + c ω×(ω×t)
  double once[3], twice[3];
  cross(omega, translation, once);
  cross(omega, once, twice);
  for (int i = 0; i < 3; ++i) twist[i] = translation[i] - 0.5 * once[i] + bend.c * twice[i];
}

void inverse_left_jacobian(const double* omega, double* A) noexcept {
  const double square = dot3(omega, omega);
  inverse_left_jacobian(omega, square, Bend(square).c, A);
}

void inverse_left_jacobian_motion(const double* twist, double* A, double* B) noexcept {
  const double *rho = twist, *omega = twist + 3;
  const double square = dot3(omega, omega), along = dot3(omega, rho);
  const Bend bend(square);
  inverse_left_jacobian(omega, square, bend.c, A);
  // B = −½P + c (ΩP + PΩ) + c′/θ (ω·ρ) Ω², with ΩP + PΩ = ωρᵀ + ρωᵀ − 2(ω·ρ)I.
  const double share = bend.slope * along;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      B[3 * i + j] = bend.c * (omega[i] * rho[j] + rho[i] * omega[j]) + share * omega[i] * omega[j];
    }
    B[4 * i] -= 2.0 * bend.c * along + share * square;
  }
  add_cross(-0.5, rho, B);
}

}  // namespace rmrc
