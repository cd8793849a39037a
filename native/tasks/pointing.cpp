#include "tasks/pointing.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/lie.hpp"

namespace rmrc {

namespace {

// rmrc.tasks.pointing: RIGHT, SLOPE, ANTIPODE and SIDEWAYS.
constexpr double right = std::numbers::sqrt2;
constexpr double slope = 0.5 * std::numbers::sqrt2;
constexpr double antipode = 1e-7;
constexpr double sideways[2] = {0.5403023058681398, 0.8414709848078965};

// The unit vector at right angles to d along which it comes nearer to a.
void find_way(const double* axis, const double* direction, double* out) noexcept {
  const double along = dot3(direction, axis);
  for (int i = 0; i < 3; ++i) out[i] = axis[i] - direction[i] * along;
  const double sine = norm3(out);
  if (sine > antipode) {
    for (int i = 0; i < 3; ++i) out[i] /= sine;
    return;
  }
  const int least = static_cast<int>(
      std::min_element(axis, axis + 3, [](double a, double b) { return std::abs(a) < std::abs(b); }) -
      axis);
  double first[3], second[3];
  for (int i = 0; i < 3; ++i) first[i] = (i == least) - direction[i] * direction[least];
  const double length = norm3(first);
  for (double& value : first) value /= length;
  cross(direction, first, second);
  for (int i = 0; i < 3; ++i) out[i] = sideways[0] * first[i] + sideways[1] * second[i];
}

}  // namespace

double pointing_angle(double length) noexcept {
  if (length <= right) return 2.0 * std::asin(0.5 * length);
  return 0.5 * std::numbers::pi + (length - right) / slope;
}

Stretch::Stretch(const double* axis, const double* chord) noexcept {
  for (int i = 0; i < 3; ++i) direction_[i] = axis[i] + chord[i];
  const double length = norm3(chord);
  trivial_ = !(length > right);
  if (trivial_) return;
  double sum[3];
  for (int i = 0; i < 3; ++i) {
    along_[i] = chord[i] / length;
    sum[i] = direction_[i] + axis[i];
  }
  half_ = std::atan2(length, norm3(sum));
  factor_ = (right + slope * (2.0 * half_ - 0.5 * std::numbers::pi)) / length;
  slope_ = slope - factor_ * std::cos(half_);
  find_way(axis, direction_, toward_);
}

Stretch Stretch::of_error(const double* axis, const double* error) noexcept {
  const double length = norm3(error);
  const double share =
      length <= right ? 1.0 : 2.0 * std::sin(0.5 * pointing_angle(length)) / length;
  const double chord[3] = {share * error[0], share * error[1], share * error[2]};
  return {axis, chord};
}

void Stretch::apply(double* x, int n) const noexcept {
  for (int j = 0; j < n; ++j) {
    const double turned =
        slope_ * (toward_[0] * x[j] + toward_[1] * x[n + j] + toward_[2] * x[2 * n + j]);
    for (int i = 0; i < 3; ++i) x[i * n + j] = factor_ * x[i * n + j] - turned * along_[i];
  }
}

void Stretch::normal(double* out) const noexcept {
  std::copy_n(direction_, 3, out);
  if (trivial_) return;
  const double tilt = slope_ * std::sin(half_) / (factor_ + slope_ * std::cos(half_));
  const double length = std::hypot(1.0, tilt);
  for (int i = 0; i < 3; ++i) out[i] = (out[i] + tilt * toward_[i]) / length;
}

}  // namespace rmrc
