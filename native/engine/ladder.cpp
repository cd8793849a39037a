// What there is of a step where its program is not solved at once: the rungs of the ladder
// (rmrc.engine.python, `_descend_ladder`).

#include <algorithm>
#include <cmath>

#include "engine/engine.hpp"
#include "solver/tolerances.hpp"

namespace rmrc {

namespace {

constexpr double more_room = 1e-8;  // rad/s or m/s; rmrc.engine.python.MORE_ROOM

}  // namespace

// Return how the step ends by the first rung that holds, from a cold start on. What the solver
// gives up on it has tried from a cold start itself.
SolveStatus Engine::descend_ladder(SolveStatus ending, bool warm) {
  if (warm && ending == SolveStatus::solved && in_time()) {
    forget();
    ending = attempt();
    if (trusted(ending)) return ending;
  }
  cuts_ = false;
  if (row_count() == 0 && equality_count() == 0) return feasible(ending) ? ending : stop(ending);
  if (!feasible(ending) && in_time() && relax()) ending = within_relaxed();
  if (trusted(ending) || feasible(ending)) return ending;
  if (in_time()) {
    relaxed_ = true;
    ending = without_rows();
    if (trusted(ending) || feasible(ending)) return ending;
  }
  return stop(ending);
}

// Whether a solver that was interrupted has left a point that keeps all limits.
bool Engine::feasible(SolveStatus ending) const {
  const bool stopped = ending == SolveStatus::max_iter || ending == SolveStatus::time_limit;
  return stopped && residuals_.primal <= certified;
}

// Give rows and equalities the least slack that lets some v of the box satisfy them; return whether
// that was found.
bool Engine::relax() {
  brake(brake_.data());
  if (!least_->find(program(), brake_.data(), end_)) return false;
  relaxed_ |= least_->violation() > inconsistency;
  move_limits();
  least_->relax(lower_.data(), upper_.data(), right_.data());
  return true;
}

// Return how the optimum of what was relaxed ends; where it is not found, the v that it was relaxed
// for is a feasible point.
SolveStatus Engine::within_relaxed() {
  SolveStatus ending = best();
  if (!trusted(ending) && !feasible(ending) && in_time()) {
    for (int r = 0; r < row_count(); ++r) {
      lower_[r] -= more_room;
      upper_[r] += more_room;
    }
    ending = best();
  }
  if (trusted(ending) || feasible(ending)) return ending;
  const Program limits = program();
  double* y = limits_ == nullptr ? nullptr : limits_->arrays().multiplier;
  double* w = equalities_ == nullptr ? nullptr : equalities_->arrays().multiplier;
  std::copy_n(least_->v(), size(), v_.begin());
  std::fill(z_.begin(), z_.end(), 0.0);
  std::fill_n(y, limits.rows, 0.0);
  std::fill_n(w, limits.equalities, 0.0);
  residuals_ = certify(size(), limits, z_.data(), y, w, v_.data(), residual_.data());
  return ending == SolveStatus::time_limit ? ending : SolveStatus::max_iter;
}

// Return how the optimum inside the box alone ends.
SolveStatus Engine::without_rows() {
  if (limits_ != nullptr) std::fill_n(limits_->arrays().multiplier, limits_->count(), 0.0);
  if (equalities_ != nullptr) {
    std::fill_n(equalities_->arrays().multiplier, equalities_->count(), 0.0);
  }
  boxed_ = true;
  forget();
  return attempt();
}

// Have the brake in place of a solution that is none.
SolveStatus Engine::stop(SolveStatus ending) {
  brake(v_.data());
  return ending == SolveStatus::solved ? SolveStatus::failed : ending;
}

}  // namespace rmrc
