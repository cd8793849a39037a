#include "engine/path.hpp"

#include <algorithm>
#include <cmath>

namespace rmrc {

namespace {

constexpr double most_steps = 9007199254740992.0;  // rmrc.engine.backtracking.MOST_STEPS

}  // namespace

Path::Path(const JointLimits& limits)
    : limits_(&limits),
      slows_(std::all_of(limits.acceleration.begin(), limits.acceleration.end(),
                         [](double a) { return std::isfinite(a); })),
      sign_(limits.acceleration.size()),
      speed_(limits.acceleration.size()),
      steps_(limits.acceleration.size()),
      change_(limits.acceleration.size()) {}

void Path::set_out(const double* v, double dt, const double* q) {
  dt_ = dt;
  last_ = 0.0;
  for (int i = 0; i < size(); ++i) {
    sign_[i] = v[i] > 0.0 ? 1.0 : v[i] < 0.0 ? -1.0 : 0.0;
    speed_[i] = std::abs(v[i]);
  }
  braking(*limits_, v, dt, q, steps_.data(), change_.data());
  for (int i = 0; i < size(); ++i) {
    steps_[i] = std::floor(steps_[i]);
    if (!std::isfinite(change_[i])) change_[i] = 0.0;
    last_ = std::max(last_, steps_[i]);
  }
  last_ = 1.0 + std::min(last_, most_steps);
}

void Path::way(double place, double* way) const {
  for (int i = 0; i < size(); ++i) {
    if (place <= 1.0) {
      way[i] = sign_[i] * speed_[i] * (place * dt_);
      continue;
    }
    const double steps = std::min(steps_[i], place - 1.0);
    const double slowed = 0.5 * change_[i] * (steps * (steps + 1.0));
    way[i] = sign_[i] * (((steps + 1.0) * speed_[i] - slowed) * dt_);
  }
}

}  // namespace rmrc
