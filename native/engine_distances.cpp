// What of the engine's step keeps distances: its command, once the program is solved, is solved
// again for the curvature of the step, or shortened (rmrc.control.engine, `_at_distance`).

#include <algorithm>
#include <cmath>

#include "engine.hpp"
#include "kernels.hpp"

namespace rmrc {

namespace {

// rmrc.control.engine: CERTIFIED and GAINED.
constexpr double certified = 1e-6;
constexpr double gained = 1e-3;

}  // namespace

// Return whether the command keeps distances, once it is corrected or shortened; false, and it is
// as it was, where that is left to others.
bool Engine::at_distance(double dt) {
  whole_ = v_;
  if (!keep_distances(dt)) return false;
  if (share_ == 1.0 || !in_time()) return true;
  const Kinematics& end = shortening_->end(whole_.data(), dt);
  if (!correction_->raise_rows(end, program_.lb, program_.ub, dt)) return true;
  corrected_ = true;
  const Outcome first{residuals_, iterations_, share_, relaxed_};
  double* y = limits_->arrays().multiplier;
  shortened_ = v_;
  first_z_ = z_;
  std::copy_n(y, limits_->count(), first_y_.begin());
  if (equalities_ != nullptr) {
    std::copy_n(equalities_->arrays().multiplier, equalities_->count(), first_w_.begin());
  }
  relaxed_ = false;
  if (trusted(best()) && keep_distances(dt) && share_ > first.share + gained) return true;
  v_ = shortened_;
  z_ = first_z_;
  std::copy_n(first_y_.begin(), limits_->count(), y);
  if (equalities_ != nullptr) {
    std::copy_n(first_w_.begin(), equalities_->count(), equalities_->arrays().multiplier);
  }
  residuals_ = first.residuals;
  iterations_ = first.iterations;
  share_ = first.share;
  relaxed_ = first.relaxed;
  return true;
}

// Shorten v towards the brake where a distance would be passed at the end of the step; false, and
// v is as it was, where that is left to others.
bool Engine::keep_distances(double dt) {
  brake(brake_.data());
  const Share found = shortening_->share(v_.data(), brake_.data(), dt);
  if (!found.known) return false;
  share_ = found.share;
  relaxed_ |= found.passed;
  if (share_ == 1.0) return true;
  for (int i = 0; i < size(); ++i) v_[i] = brake_[i] + share_ * (v_[i] - brake_[i]);
  relaxed_ |= misses();
  return true;
}

// Whether a shortened command misses equalities, or is faster than a frame may be: of a speed its
// norm counts, not the box inside it that the rows are.
bool Engine::misses() const {
  if (equalities_ != nullptr) {
    const EqualityArrays& held = equalities_->arrays();
    for (int r = 0; r < equalities_->count(); ++r) {
      const double* row = held.matrix + static_cast<long>(r) * size();
      if (std::abs(dot(row, v_.data(), size()) - held.right[r]) > certified) return true;
    }
  }
  const RowArrays& rows = limits_->arrays();
  double worst = 0.0;
  for (int first = 0; first < limits_->speed_count(); first += 3) {
    double speed = 0.0, most = 0.0;
    for (int row = first; row < first + 3; ++row) {
      const double along =
          dot(rows.matrix + static_cast<long>(row) * size(), v_.data(), size());
      speed += along * along;
      most += rows.upper[row] * rows.upper[row];
    }
    worst = std::max(worst, std::sqrt(speed) - std::sqrt(most));
  }
  return worst > certified;
}

}  // namespace rmrc
