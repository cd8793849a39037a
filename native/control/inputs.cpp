#include "control/inputs.hpp"

#include <algorithm>
#include <cmath>

namespace rmrc {

bool normalize(double* turn) {
  double square = 0.0;
  for (int i = 0; i < 4; ++i) square += turn[i] * turn[i];
  const double norm = std::sqrt(square);
  for (int i = 0; i < 4; ++i) turn[i] /= norm;
  return norm >= zero_norm;
}

bool Aim::take(const Given& given) const {
  double next[7], rates[6];
  const int size = pose ? 7 : 3;
  std::copy_n(target, size, next);
  if (given.position != nullptr) {
    double* point = pose ? next + 4 : next;
    std::copy_n(given.position, 3, point);
    const double square = point[0] * point[0] + point[1] * point[1] + point[2] * point[2];
    if (!(square < largest_input * largest_input)) return false;  // NaN is not less
  }
  if (given.quaternion != nullptr) {
    double square = 0.0;
    for (int i = 0; i < 4; ++i) square += given.quaternion[i] * given.quaternion[i];
    if (!(zero_norm * zero_norm < square && square < largest_input * largest_input)) return false;
    const double scale = 1.0 / std::sqrt(square);
    for (int i = 0; i < 4; ++i) next[i] = given.quaternion[i] * scale;
  }
  if (given.velocity != nullptr) {
    for (int i = 0; i < width(); ++i) {
      rates[i] = given.velocity[i];
      if (!(std::abs(rates[i]) < largest_input)) return false;
    }
    std::copy_n(rates, width(), twist);
  }
  std::copy_n(next, size, target);
  *moving = given.velocity != nullptr;
  return true;
}

}  // namespace rmrc
