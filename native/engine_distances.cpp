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
constexpr double forced = 1e-9;  // rmrc.control.engine.FORCED

}  // namespace

// Have the command keep distances: corrected, or shortened.
void Engine::at_distance(double dt) {
  whole_ = v_;
  const bool relaxed = relaxed_;
  keep_distances(dt);
  if (share_ == 1.0 || boxed_ || !in_time()) return;
  correction_->begin();
  correction_->see(shortening_->there(), shortening_->go_to_end(whole_.data(), dt));
  const double rest = shortening_->go_to_rest(whole_.data(), dt);
  if (rest > 0.0) correction_->see(shortening_->there(), rest);
  move_limits();
  if (!correction_->raise_rows(program_.lb, program_.ub, lower_.data())) return;
  const Outcome first{residuals_, iterations_, share_, relaxed_};
  double* y = limits_->arrays().multiplier;
  shortened_ = v_;
  first_z_ = z_;
  std::copy_n(y, limits_->count(), first_y_.begin());
  if (equalities_ != nullptr) {
    std::copy_n(equalities_->arrays().multiplier, equalities_->count(), first_w_.begin());
  }
  relaxed_ = relaxed;
  if (trusted(best())) {
    keep_distances(dt);
    if (share_ > first.share + gained) return;
  }
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
}

// Shorten v towards the brake where a distance would be passed at the end of the step.
void Engine::keep_distances(double dt) {
  brake(brake_.data());
  const Share found = shortening_->share(v_.data(), brake_.data(), dt, end_);
  share_ = found.share;
  relaxed_ |= found.passed || (share_ == 0.0 && !in_time() && is_forced());
  if (share_ == 1.0) return;
  for (int i = 0; i < size(); ++i) v_[i] = brake_[i] + share_ * (v_[i] - brake_[i]);
  relaxed_ |= !boxed_ && misses();
}

// Whether the brake goes on otherwise than the joints would stop by themselves, as where they come
// back into their ranges: its way to rest is then not what the step before has looked at.
bool Engine::is_forced() const {
  for (int i = 0; i < size(); ++i) {
    if (!std::isfinite(box_.limits().acceleration[i])) continue;
    if (std::abs(brake_[i]) > std::abs(planned_[i]) + forced) return true;
  }
  return false;
}

// Whether a shortened command misses equalities, or is faster than a frame may be: of a speed its
// norm counts, not the box inside it that the rows are.
bool Engine::misses() const {
  const Program limits = program();
  for (int r = 0; r < limits.equalities; ++r) {
    const double* row = limits.E + static_cast<long>(r) * size();
    if (std::abs(dot(row, v_.data(), size()) - limits.f[r]) > certified) return true;
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
