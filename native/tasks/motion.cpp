#include "tasks/motion.hpp"

#include <algorithm>
#include <cmath>

#include "base/lie.hpp"

namespace rmrc {

namespace {

constexpr double least_angle = 1e-9;    // rad

}  // namespace

void set_blocks(double* T, const double* A, const double* B, const double* D) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      T[6 * i + j] = A[3 * i + j];
      T[6 * i + 3 + j] = B[3 * i + j];
      T[6 * (i + 3) + j] = 0.0;
      T[6 * (i + 3) + 3 + j] = D[3 * i + j];
    }
  }
}

void measure_motion(const double* e, double* measures) {
  const double *rho = e, *omega = e + 3;
  const double angle = norm3(omega), square = dot3(rho, rho);
  measures[1] = angle;
  if (angle < least_angle) {
    measures[0] = std::sqrt(square);
    return;
  }
  const double projection = dot3(rho, omega) / angle, along = projection * projection;
  const double ratio = 2.0 * std::sin(0.5 * angle) / angle;
  measures[0] = std::sqrt(along + ratio * ratio * std::max(square - along, 0.0));
}

}  // namespace rmrc
