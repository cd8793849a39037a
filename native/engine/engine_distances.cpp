// What of the engine's step keeps distances and the speeds of frames: its command, once the program
// is solved, is solved again for the curvature of the step or of the speeds, or shortened
// (rmrc.engine.python, `_cut` and `_at_distance`).

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "engine/engine.hpp"
#include "solver/tolerances.hpp"

namespace rmrc {

namespace {

constexpr double gained = 1e-3;  // rmrc.engine.python.GAINED
constexpr double forced = 1e-9;  // rmrc.engine.python.FORCED

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
  SolveStatus corrected = best();
  while (trusted(corrected) && cut()) corrected = best();
  if (trusted(corrected) && !(limits_->excess(v_.data()) > 0.0)) {
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
// norm counts, not the planes that stand for it.
bool Engine::misses() const {
  const Program limits = program();
  for (int r = 0; r < limits.equalities; ++r) {
    const double* row = limits.E + static_cast<long>(r) * size();
    if (std::abs(dot(row, v_.data(), size()) - limits.f[r]) > certified) return true;
  }
  return limits_->excess(v_.data()) > certified;
}

// Change the program where v moves frames too fast; return whether it was. The programs of a cascade
// have no cost in common that the curvature could be added to.
bool Engine::cut() {
  const bool curved = cascade_ == nullptr;
  if (curved && !bent_) std::copy_n(program_.H, plain_.size(), plain_.begin());
  const bool changed =
      limits_->cut(v_.data(), curved ? program_.H : nullptr, plain_.data());
  bent_ |= curved && changed;
  if (changed && moved_) {
    std::copy_n(limits_->arrays().upper, limits_->speed_count(), upper_.begin());
  }
  return changed;
}

// Have no frame faster than it may be, where v was not found by planes alone.
void Engine::slow_down() {
  if (limits_ == nullptr || limits_->speed_count() == 0 || limits_->excess(v_.data()) <= 0.0) {
    return;
  }
  brake(brake_.data());
  const double share = limits_->share_of_speeds(brake_.data(), v_.data());
  if (share > 0.0 && share < 1.0) {
    for (int i = 0; i < size(); ++i) v_[i] = brake_[i] + share * (v_[i] - brake_[i]);
  }
  relaxed_ |= misses();
}

}  // namespace rmrc
