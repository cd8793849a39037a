#include "lie.hpp"

#include <algorithm>
#include <cmath>

namespace rmrc {

namespace {

// Below it an angle, or its square, counts as none. These are the thresholds of the Python engine's
// operations: what they round off is part of the result that is to be the same.
constexpr double nothing = 1e-10;

void set_unit(double* A) noexcept {
  std::fill_n(A, 9, 0.0);
  A[0] = A[4] = A[8] = 1.0;
}

void skew(const double* v, double* out) noexcept {
  out[0] = out[4] = out[8] = 0.0;
  out[1] = -v[2];
  out[2] = v[1];
  out[3] = v[2];
  out[5] = -v[0];
  out[6] = -v[1];
  out[7] = v[0];
}

// θ = ‖ω‖ with its sine and cosine.
struct Angle {
  explicit Angle(const double* omega)
      : square(dot3(omega, omega)),
        theta(std::sqrt(square)),
        sine(std::sin(theta)),
        cosine(std::cos(theta)) {}

  double square, theta, sine, cosine;
};

// Jl⁻¹(ω) of SO(3).
void inverse_left_jacobian(const double* omega, const Angle& angle, double* out) noexcept {
  const double beta =
      (1.0 - angle.theta * angle.sine / (2.0 * (1.0 - angle.cosine))) / angle.square;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[3 * i + j] = beta * omega[i] * omega[j];
    out[4 * i] += 1.0 - beta * angle.square;
  }
  out[1] += 0.5 * omega[2];
  out[2] -= 0.5 * omega[1];
  out[3] -= 0.5 * omega[2];
  out[5] += 0.5 * omega[0];
  out[6] += 0.5 * omega[1];
  out[7] -= 0.5 * omega[0];
}

// Q of the left Jacobian [J Q; 0 J] of SE(3): Barfoot, State Estimation for Robotics, eq. 7.86.
void coupling_block(const double* rho, const double* omega, const Angle& angle,
                    double* Q) noexcept {
  // Near θ = 0 these lose digits, and are to lose the same as in the Python engine: as they stand.
  const double square = angle.square, theta = angle.theta, sine = angle.sine, cosine = angle.cosine;
  const double fourth = square * square;
  const double b = (theta - sine) / (square * theta);
  const double c = (1.0 - 0.5 * square - cosine) / fourth;
  const double d = (2.0 * theta - 3.0 * sine + theta * cosine) / (2.0 * fourth * theta);
  double P[9], W[9], PW[9], WP[9], WPW[9], PWW[9], WWP[9], WPWW[9], WWPW[9];
  skew(rho, P);
  skew(omega, W);
  multiply3(P, W, PW);
  multiply3(W, P, WP);
  multiply3(WP, W, WPW);
  multiply3(PW, W, PWW);
  multiply3(W, WP, WWP);
  multiply3(WPW, W, WPWW);
  multiply3(W, WPW, WWPW);
  for (int k = 0; k < 9; ++k) {
    Q[k] = 0.5 * P[k] + b * (WP[k] + PW[k] + WPW[k]) - c * (WWP[k] + PWW[k] - 3.0 * WPW[k]) +
           d * (WPWW[k] + WWPW[k]);
  }
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

void log_rotation(const double* quaternion, double* omega, double least) noexcept {
  const double sine = std::sqrt(dot3(quaternion + 1, quaternion + 1));
  const double w = quaternion[0];
  double scale = 0.0;
  if (sine > least) {
    // Of the two quaternions of the rotation, the one with w ≥ 0.
    scale = std::copysign(2.0 * std::atan2(sine, std::abs(w)) / sine, w < 0.0 ? -1.0 : 1.0);
  }
  for (int i = 0; i < 3; ++i) omega[i] = scale * quaternion[1 + i];
}

void log_motion(const double* quaternion, const double* translation, double* twist) noexcept {
  double* omega = twist + 3;
  log_rotation(quaternion, omega, nothing);
  const double square = dot3(omega, omega);
  double factor = 1.0 / 12.0;
  if (square >= nothing) {
    const double half = 0.5 * std::sqrt(square);
    factor = (1.0 - half * std::cos(half) / std::sin(half)) / square;
  }
  // V⁻¹t = t − ½ ω×t + f ω×(ω×t)
  double once[3], twice[3];
  cross(omega, translation, once);
  cross(omega, once, twice);
  for (int i = 0; i < 3; ++i) twist[i] = translation[i] - 0.5 * once[i] + factor * twice[i];
}

void inverse_left_jacobian(const double* omega, double* A) noexcept {
  if (dot3(omega, omega) < nothing) {
    set_unit(A);
  } else {
    inverse_left_jacobian(omega, Angle(omega), A);
  }
}

void inverse_left_jacobian_motion(const double* twist, double* A, double* B) noexcept {
  const double* omega = twist + 3;
  if (dot3(omega, omega) < nothing) {
    set_unit(A);
    std::fill_n(B, 9, 0.0);
    return;
  }
  const Angle angle(omega);
  double Q[9], AQ[9];
  inverse_left_jacobian(omega, angle, A);
  coupling_block(twist, omega, angle, Q);
  multiply3(A, Q, AQ);
  multiply3(AQ, A, B);
  for (int k = 0; k < 9; ++k) B[k] = -B[k];
}

}  // namespace rmrc
