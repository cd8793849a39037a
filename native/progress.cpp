#include "progress.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace rmrc {

namespace {

// rmrc.control.progress: WINDOW, LOOKS, SHARE and TOLERANCES.
constexpr double window = 0.25;
constexpr int looks = 10;
constexpr double share = 1e-3;
constexpr double tolerances = 0.1;

constexpr double infinity = std::numeric_limits<double>::infinity();

}  // namespace

Progress::Progress(std::vector<Watched> watched, double tolerance, const double* targets, int size)
    : watched_(std::move(watched)), tolerance_(tolerance), targets_(targets), last_(size) {
  reset();
}

void Progress::reset() {
  stuck_ = false;
  since_look_ = 0.0;
  std::copy_n(targets_, last_.size(), last_.begin());
  before_ = infinity;
  begin();
}

void Progress::begin() {
  elapsed_ = 0.0;
  least_ = infinity;
  fastest_ = -infinity;
  still_ = moving_ = true;
}

void Progress::keep(Memory& memory) {
  memory(last_);
  memory(stuck_);
  memory(since_look_);
  memory(before_);
  memory(elapsed_);
  memory(least_);
  memory(fastest_);
  memory(still_);
  memory(moving_);
}

void Progress::update(const Engine& engine, const double* v, double dt) {
  since_look_ += dt;
  if (since_look_ * looks < window || watched_.empty()) return;
  look(engine, v, std::exchange(since_look_, 0.0));
}

void Progress::look(const Engine& engine, const double* v, double elapsed) {
  bool off = false;
  double square = 0.0, asked = 0.0, speed = 0.0;
  for (const Watched& watched : watched_) {
    const RowTerm& term = *engine.row_terms()[watched.term];
    const double* error = engine.stack().error + term.data().first;
    const double* rate = engine.rate() + term.data().first;
    double measures[2];
    term.measure(measures);
    off |= measures[0] > watched.tolerance[0] || measures[1] > watched.tolerance[1];
    for (int r = 0; r < term.data().rows; ++r) {
      const double pull = watched.weight[r] * error[r];
      square += pull * error[r];
      asked += pull * rate[r];
      speed += pull * term.rate_of(r, v);
    }
  }
  if (!off || !(square > 0.0)) {
    reset();
    return;
  }
  const double length = std::sqrt(square);
  elapsed_ += elapsed;
  least_ = std::min(least_, length);
  fastest_ = std::max(fastest_, speed / length);
  const bool moved = !std::equal(last_.begin(), last_.end(), targets_);
  still_ &= !moved;
  moving_ &= moved;
  std::copy_n(targets_, last_.size(), last_.begin());
  if (elapsed_ >= window) judge(std::min(tolerances * tolerance_, share * asked / length));
}

// Say at the end of a window whether the tasks are stuck.
void Progress::judge(double slowest) {
  stuck_ = still_ ? std::abs(before_ - least_) < slowest * elapsed_ : moving_ && fastest_ < slowest;
  before_ = least_;
  begin();
}

}  // namespace rmrc
