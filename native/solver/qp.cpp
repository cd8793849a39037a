#include "solver/qp.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/kernels.hpp"
#include "base/numbers.hpp"
#include "solver/qp_limits.hpp"

namespace rmrc {

namespace {

// A limit is passed, relative to the largest of 1 and itself, and a multiplier has the wrong sign,
// relative to the terms of the gradient, by more than this; ten times more at each look at the
// working set, so that limits active by a hair cannot be taken up and dropped for ever.
constexpr double first_tolerance = 1e-13;
constexpr int looks = 6;
// Changes of the working set in one look, for each variable, and for each row. More go in circles,
// which a larger tolerance breaks.
constexpr int changes_by_variable = 6;

// Whether a multiplier is smaller than −least on the side that its limit acts on.
bool points_back(Side side, double multiplier, double least = 0.0) {
  return one_sided(side) && sign_of(side) * multiplier < -least;
}

bool all_finite(const double* x, int n) { return std::isfinite(dot(x, x, n)); }

// The side on which a limit of the last working set can still be held.
Side still(Side side, double lower, double upper) {
  if (lower == upper) return Side::both;
  if (side == Side::lower && lower > -infinity) return side;
  if (side == Side::upper && upper < infinity) return side;
  return Side::none;
}

}  // namespace

QPSolver::QPSolver(int size, int max_rows, int max_equalities, int max_iterations)
    : size_(size),
      max_rows_(max_rows),
      max_equalities_(max_equalities),
      max_iterations_(max_iterations),
      free_(size),
      held_(size),
      active_(size),
      bound_side_(size, Side::none),
      row_side_(max_rows + max_equalities, Side::none),
      keys_(max_rows),
      side_before_(max_rows),
      factor_(size),
      basis_(size),
      v_(size),
      z_(size),
      y_(size),
      row_multiplier_(max_rows + max_equalities),
      residual_(size),
      misfit_(size),
      dv_(size),
      dz_(size),
      dy_(size),
      free_step_(size),
      reduced_(size),
      coefficients_(size) {}

void QPSolver::forget() {
  warm_ = false;
  std::fill(bound_side_.begin(), bound_side_.end(), Side::none);
  std::fill(row_side_.begin(), row_side_.end(), Side::none);
}

void QPSolver::resize(int size) {
  if (size == size_) return;
  size_ = size;
  forget();
}

void QPSolver::keep(Memory& memory) {
  memory(size_);
  memory(warm_);
  memory(rows_);
  memory(equalities_);
  memory(bound_side_);
  memory(key_count_);
  memory.some(row_side_.data(), std::max(rows_ + equalities_, key_count_), row_side_.size());
  memory.some(keys_.data(), key_count_, keys_.size());
}

SolveStatus QPSolver::solve(const Program& program, Clock::time_point end) {
  program_ = &program;
  end_ = end;
  iterations_ = 0;
  find_rows_again();
  SolveStatus status = SolveStatus::failed;
  if (finite()) {
    status = read_limits() ? run() : SolveStatus::infeasible;
    if (status != SolveStatus::solved && status != SolveStatus::time_limit && warm_) {
      // What rounding did on the way from an old working set says nothing about the program.
      forget();
      if (read_limits()) status = run();
    }
  }
  warm_ = status == SolveStatus::solved || status == SolveStatus::time_limit;
  if (!warm_) forget();
  solved_ = status == SolveStatus::solved;
  if (!solved_) rest();
  return status;
}

// Take the sides over for the rows that are still there.
void QPSolver::find_rows_again() {
  const Program& p = *program_;
  if (p.keys != nullptr) {
    std::copy_n(row_side_.begin(), key_count_, side_before_.begin());
    for (int r = 0, old = 0; r < p.rows; ++r) {
      while (old < key_count_ && keys_[old] < p.keys[r]) ++old;
      const bool known = old < key_count_ && keys_[old] == p.keys[r];
      row_side_[r] = known ? side_before_[old] : Side::none;
    }
    std::copy_n(p.keys, p.rows, keys_.begin());
    key_count_ = p.rows;
  } else if (p.rows != rows_ || p.equalities != equalities_) {
    // The rows are others than those of the last working set.
    std::fill(row_side_.begin(), row_side_.end(), Side::none);
    key_count_ = 0;
  }
  rows_ = p.rows;
  equalities_ = p.equalities;
}

// Whether all numbers are finite, and no limit is NaN.
bool QPSolver::finite() const {
  const Program& p = *program_;
  const int n = size_;
  if (!all_finite(p.H, n * n) || !all_finite(p.g, n) || !all_finite(p.C, rows_ * n) ||
      !all_finite(p.E, equalities_ * n) || !all_finite(p.f, equalities_)) {
    return false;
  }
  bool known = true;
  for (int i = 0; i < n; ++i) known &= p.lb[i] == p.lb[i] && p.ub[i] == p.ub[i];
  for (int r = 0; r < rows_; ++r) known &= p.lo[r] == p.lo[r] && p.hi[r] == p.hi[r];
  return known;
}

// Carry the sides of the last working set over to these limits; false if a pair contradicts itself.
bool QPSolver::read_limits() {
  const Program& p = *program_;
  bool ordered = true;
  for (int i = 0; i < size_; ++i) {
    ordered &= p.lb[i] <= p.ub[i] && p.lb[i] < infinity && p.ub[i] > -infinity;
    bound_side_[i] = still(bound_side_[i], p.lb[i], p.ub[i]);
  }
  for (int r = 0; r < rows_; ++r) {
    ordered &= p.lo[r] <= p.hi[r] && p.lo[r] < infinity && p.hi[r] > -infinity;
    row_side_[r] = still(row_side_[r], p.lo[r], p.hi[r]);
  }
  std::fill_n(row_side_.begin() + rows_, equalities_, Side::both);
  return ordered;
}

SolveStatus QPSolver::run() {
  factorize();
  settle(true);
  double tolerance = first_tolerance;
  if (!release_pushed_back(tolerance)) return SolveStatus::time_limit;
  bool settled = true;  // whether v solves the working set's equations, but for rounding
  for (int look = 0; look < looks; ++look, tolerance *= 10.0) {
    bool changed = false;
    const int most = iterations_ + changes_by_variable * size_ + rows_;
    for (Limit limit; iterations_ < most && most_violated(tolerance, limit); changed = true) {
      const SolveStatus status = enforce(limit);
      if (status == SolveStatus::solved) {
        settled = false;
      } else if (settled || status == SolveStatus::max_iter || status == SolveStatus::time_limit) {
        return status;
      } else {
        // What the steps before have added up to is no proof of a contradiction.
        settle(false);
        if (!release_pushed_back(tolerance)) return SolveStatus::time_limit;
        settled = true;
      }
    }
    if (!changed) return finish();
    settle(false);
    if (!release_pushed_back(tolerance)) return SolveStatus::time_limit;
    settled = true;
  }
  return SolveStatus::max_iter;
}

// Spread the multipliers of the working set over all limits; a sign wrong by a hair becomes 0.
SolveStatus QPSolver::finish() {
  for (int k = 0; k < free_count_; ++k) z_[free_[k]] = 0.0;
  for (int k = 0; k < held_count_; ++k) {
    double& value = z_[held_[k]];
    if (points_back(bound_side_[held_[k]], value)) value = 0.0;
  }
  std::fill_n(row_multiplier_.begin(), rows_ + equalities_, 0.0);
  for (int t = 0; t < active_count_; ++t) {
    if (!points_back(row_side_[active_[t]], y_[t])) row_multiplier_[active_[t]] = y_[t];
  }
  const bool sound = all_finite(v_.data(), size_) && all_finite(z_.data(), size_) &&
                     all_finite(y_.data(), active_count_);
  return sound ? SolveStatus::solved : SolveStatus::failed;
}

// Release every limit whose multiplier has the wrong sign, for it holds v back from the optimum,
// until none has: a working set that the dual method may start from. False if the time is over.
bool QPSolver::release_pushed_back(double tolerance) {
  for (bool released = true; released;) {
    const double least = tolerance * scale_;
    released = false;
    for (int k = held_count_ - 1; k >= 0; --k) {
      if (!points_back(bound_side_[held_[k]], z_[held_[k]], least)) continue;
      release_bound(k);
      released = true;
    }
    for (int t = active_count_ - 1; t >= 0; --t) {
      if (!points_back(row_side_[active_[t]], y_[t], least)) continue;
      release_row(t);
      released = true;
    }
    if (released) {
      if (is_over(end_)) return false;
      rebuild_basis();
      settle(false);
    }
  }
  return true;
}

// Find the limit that v passes by most: among the bounds, and among the rows where all bounds hold.
bool QPSolver::most_violated(double tolerance, Limit& found) const {
  const Program& p = *program_;
  double worst = 0.0;
  const auto look_at = [&](Side side, bool is_bound, int index, double value, double lower,
                           double upper) {
    const double below = lower - value, above = value - upper;
    const double allowed = side == Side::implied ? implied_tolerance : tolerance;
    if (below > std::max(worst, relative(allowed, lower))) {
      worst = below;
      found = {is_bound, index, -1.0};
    }
    if (above > std::max(worst, relative(allowed, upper))) {
      worst = above;
      found = {is_bound, index, 1.0};
    }
  };
  for (int k = 0; k < free_count_; ++k) {
    const int i = free_[k];
    look_at(bound_side_[i], true, i, v_[i], p.lb[i], p.ub[i]);
  }
  if (worst > 0.0) return true;
  for (int r = 0; r < rows_ + equalities_; ++r) {
    if (held(row_side_[r])) continue;
    const double activity = dot(row(r), v_.data(), size_);
    look_at(row_side_[r], false, r, activity, row_lower(r), row_upper(r));
  }
  return worst > 0.0;
}

void QPSolver::rest() {
  std::fill(v_.begin(), v_.end(), 0.0);
  std::fill(z_.begin(), z_.end(), 0.0);
  std::fill_n(row_multiplier_.begin(), rows_ + equalities_, 0.0);
}

}  // namespace rmrc
