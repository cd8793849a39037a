#include "speed.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "lie.hpp"

namespace rmrc {

namespace {

constexpr double forward = 0.97;  // rmrc.problem.limits.speed.FORWARD
constexpr double no_direction = 1e-12;

// An orthonormal basis (3, 3), by rows, whose first vector is along a direction: a Householder
// reflection takes x̂ to it.
void basis_along(const double* direction, double length, double* basis) {
  double mirror[3] = {0.0, 0.0, 0.0}, scale = 0.0;
  if (length >= no_direction) {
    for (int i = 0; i < 3; ++i) mirror[i] = direction[i] / length;
    mirror[0] += std::copysign(1.0, mirror[0]);
    scale = 2.0 / dot3(mirror, mirror);
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      basis[3 * i + j] = (i == j ? 1.0 : 0.0) - scale * mirror[i] * mirror[j];
    }
  }
}

}  // namespace

SpeedRows::SpeedRows(Frame frame, bool turned, double linear, double angular, const double* rate,
                     const double* cdof)
    : frame_(std::move(frame)), turned_(turned), halves_(0), rate_(rate), cdof_(cdof) {
  const double largest[2] = {linear, angular};
  for (int half = 0; half < 2; ++half) {
    if (largest[half] == std::numeric_limits<double>::infinity()) continue;
    at_[halves_] = 3 * half;
    largest_[halves_++] = largest[half];
  }
}

void SpeedRows::write(const int* place, int n, double* rows, double* bound) const {
  std::fill_n(rows, count() * n, 0.0);
  for (int half = 0; half < halves_; ++half) {
    const double* asked = rate_ + at_[half];
    double wanted[3] = {asked[0], asked[1], asked[2]}, basis[9];
    if (turned_) rotate(frame_.rotation, asked, wanted);
    const double length = std::sqrt(dot3(wanted, wanted)), largest = largest_[half];
    const double first =
        std::min(std::max(length, largest / std::sqrt(3.0)), forward * largest);
    double* b = bound + 3 * half;
    b[0] = first;
    b[1] = b[2] = std::sqrt(0.5 * (largest * largest - first * first));
    basis_along(wanted, length, basis);
    double arm[3];
    for (int i = 0; i < 3; ++i) arm[i] = frame_.position[i] - frame_.reference[i];
    for (const int dof : frame_.dofs) {
      if (place[dof] < 0) continue;
      const double* axis = cdof_ + 6 * dof;
      double moved[3] = {axis[0], axis[1], axis[2]};
      if (at_[half] == 0) {
        cross(axis, arm, moved);
        for (int i = 0; i < 3; ++i) moved[i] += axis[3 + i];
      }
      for (int i = 0; i < 3; ++i) rows[(3 * half + i) * n + place[dof]] = dot3(basis + 3 * i, moved);
    }
  }
}

}  // namespace rmrc
