#include "control/progress.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rmrc {

namespace {

// rmrc.control.progress: REST, WINDOW, SHARE and TOLERANCES.
constexpr double rest = 1e-3;
constexpr double window = 0.25;
constexpr double share = 1e-3;
constexpr double tolerances = 0.1;

}  // namespace

Progress::Progress(std::vector<Watched> watched, double tolerance)
    : watched_(std::move(watched)), tolerance_(tolerance) {}

void Progress::reset() {
  stuck_ = false;
  rested_ = 0.0;
}

void Progress::keep(Memory& memory) {
  memory(stuck_);
  memory(rested_);
}

void Progress::update(const Engine& engine, const double* v, double dt) {
  if (watched_.empty()) return;
  bool rests = true;
  for (int i = 0; i < engine.size() && rests; ++i) rests = std::abs(v[i]) <= rest;
  rests = rests && off(engine) && stays(engine, v);
  rested_ = rests ? rested_ + dt : 0.0;
  stuck_ = rested_ >= window;
}

// Whether an error is above its tolerance.
bool Progress::off(const Engine& engine) const {
  return std::any_of(watched_.begin(), watched_.end(), [&](const Watched& watched) {
    double measures[2];
    engine.row_terms()[watched.term]->measure(measures);
    return measures[0] > watched.tolerance[0] || measures[1] > watched.tolerance[1];
  });
}

// Whether v brings the tasks no nearer.
bool Progress::stays(const Engine& engine, const double* v) const {
  double square = 0.0, asked = 0.0, speed = 0.0;
  for (const Watched& watched : watched_) {
    const RowTerm& term = *engine.row_terms()[watched.term];
    const double* error = engine.stack().error + term.data().first;
    const double* rate = engine.rate() + term.data().first;
    for (int r = 0; r < term.data().rows; ++r) {
      const double pull = watched.weight[r] * error[r];
      square += pull * error[r];
      asked += pull * rate[r];
      speed += pull * term.rate_of(r, v);
    }
  }
  return speed < std::min(tolerances * tolerance_ * std::sqrt(square), share * asked);
}

}  // namespace rmrc
