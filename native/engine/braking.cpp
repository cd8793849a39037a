#include "engine/braking.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.qp.braking: STEADY, EASED and TRACKED.
constexpr double steady = 0.37;
constexpr double eased = 0.4;
constexpr double tracked = 0.6;

bool any_finite(const std::vector<double>& values) {
  return std::any_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

}  // namespace

Braking::Braking(const JointLimits& limits)
    : limits_(limits),
      brakes_(any_finite(limits.acceleration) || any_finite(limits.jerk)),
      jerks_(any_finite(limits.jerk)) {
  const std::size_t n = limits.velocity.size();
  for (auto* values : {&driven_, &way_, &v_, &left_, &slope_}) values->resize(n);
  factor_.resize(n * n);
}

double Braking::slow(const double* H, double gain, double dt) {
  const int n = static_cast<int>(v_.size());
  if (!factorize(H)) return -1.0;
  v_ = driven_;
  left_ = way_;
  solve(v_.data());
  solve(left_.data());
  double share = infinity, slowest = 0.0;
  for (int i = 0; i < n; ++i) {
    const double speed = std::abs(v_[i]), left = std::max(std::abs(left_[i]), speed / gain);
    const double decay = slope_[i] = speed > 0.0 ? speed / left : gain;
    if (!(speed > 0.0)) continue;
    const double jerk = limits_.jerk[i];
    const double a = std::min(limits_.acceleration[i], std::cbrt(jerk * jerk * left));
    if (!std::isfinite(a)) continue;
    double c = 0.5 * a * dt;
    if (std::isfinite(jerk)) {
      c = std::max({c, steady * a * a / jerk, a / decay - eased * jerk / (decay * decay)});
    }
    const double top = 2.0 * a * left / (std::sqrt(c * c + 2.0 * a * left) + c);
    if (top / speed < share) {
      share = top / speed;
      slowest = a / (top + c);
    }
  }
  if (!(share < 1.0)) return 1.0;
  std::fill(slope_.begin(), slope_.end(), slowest);
  return share;
}

const double* Braking::followed(double share, const double* v_previous, double dt) {
  for (std::size_t i = 0; i < v_.size(); ++i) {
    const double fastest = limits_.velocity[i], limit = limits_.acceleration[i];
    const double r = std::clamp(share * v_[i], -fastest, fastest), jerk = limits_.jerk[i];
    const double missing = r - v_previous[i], direct = missing / dt;
    double rate = direct;
    if (std::isfinite(jerk)) {
      const double change = tracked * jerk * dt;
      const double approach =
          std::sqrt(change * change + 2.0 * tracked * jerk * std::abs(missing)) - change;
      rate = std::clamp(-slope_[i] * r, -limit, limit) + std::copysign(approach, missing);
      rate = missing >= 0.0 ? std::min(direct, rate) : std::max(direct, rate);
    }
    v_[i] = v_previous[i] + dt * rate;
  }
  return v_.data();
}

// L Lᵀ = H, by rows.
bool Braking::factorize(const double* H) {
  const int n = static_cast<int>(v_.size());
  for (int i = 0; i < n; ++i) {
    double* row = factor_.data() + i * n;
    for (int j = 0; j <= i; ++j) {
      const double rest = H[i * n + j] - dot(row, factor_.data() + j * n, j);
      if (j < i) {
        row[j] = rest / factor_[j * n + j];
      } else if (rest > 0.0 && std::isfinite(rest)) {
        row[i] = std::sqrt(rest);
      } else {
        return false;
      }
    }
  }
  return true;
}

void Braking::solve(double* x) const {
  const int n = static_cast<int>(v_.size());
  for (int i = 0; i < n; ++i) {
    x[i] = (x[i] - dot(factor_.data() + i * n, x, i)) / factor_[i * n + i];
  }
  for (int i = n - 1; i >= 0; --i) {
    x[i] /= factor_[i * n + i];
    for (int j = 0; j < i; ++j) x[j] -= factor_[i * n + j] * x[i];
  }
}

}  // namespace rmrc
