#include "progress.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rmrc {

namespace {

// rmrc.control.progress: WINDOW, LOOKS, SHARE and TOLERANCES.
constexpr double window = 0.25;
constexpr int looks = 10;
constexpr double share = 1e-3;
constexpr double tolerances = 0.1;

}  // namespace

Progress::Progress(std::vector<Watched> watched, double tolerance)
    : watched_(std::move(watched)), tolerance_(tolerance) {}

void Progress::reset() {
  since_look_ = without_ = 0.0;
  stuck_ = false;
}

void Progress::update(const Engine& engine, double dt) {
  since_look_ += dt;
  if (since_look_ * looks < window || watched_.empty()) return;
  const double elapsed = std::exchange(since_look_, 0.0);
  without_ = stands(engine) ? without_ + elapsed : 0.0;
  stuck_ = without_ >= window;
}

bool Progress::stands(const Engine& engine) const {
  bool open = false;
  double square = 0.0, asked = 0.0, speed = 0.0;
  for (const Watched& watched : watched_) {
    const RowTerm& term = *engine.row_terms()[watched.term];
    const double* error = engine.stack().error + term.data().first;
    const double* rate = engine.rate() + term.data().first;
    double measures[2], moved[6];
    term.measure(measures);
    open |= measures[0] > watched.tolerance[0] || measures[1] > watched.tolerance[1];
    term.multiply(engine.v(), moved);
    for (int r = 0; r < term.data().rows; ++r) {
      const double pull = watched.weight[r] * error[r];
      square += pull * error[r];
      asked += pull * rate[r];
      speed += pull * moved[r];
    }
  }
  if (!open || !(square > 0.0)) return false;
  const double length = std::sqrt(square);
  return speed / length < std::min(tolerances * tolerance_, share * asked / length);
}

}  // namespace rmrc
