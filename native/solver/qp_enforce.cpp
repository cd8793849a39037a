// The way of the dual method to a limit that is violated, and what becomes of the working set.

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "solver/qp.hpp"
#include "solver/qp_limits.hpp"

namespace rmrc {

namespace {

// What the rates of a proof of infeasibility may miss, relative to the limit's own gradient.
constexpr double balance_tolerance = 1e-10;
// rad/s or m/s: what only a v further away than this could meet is not met.
constexpr double farthest = 1e9;

}  // namespace

// Raise the multiplier of a violated limit from 0 until the limit is met, releasing on the way
// those whose own multipliers come down to 0. The dual objective grows with every step.
SolveStatus QPSolver::enforce(const Limit& limit) {
  double multiplier = 0.0;
  while (iterations_ < max_iterations_) {
    if (is_over(end_)) return SolveStatus::time_limit;  // quickly looked at, beside what follows
    const bool independent = find_direction(limit);
    const double passed = violation(limit), excess = std::max(0.0, passed);
    const double whole = independent ? excess / curvature_ : infinity;
    // Beyond the range of a double a way has no length: H is not positive definite, or as good as
    // not. What follows compares, and a NaN is neither more nor less than anything.
    if (!std::isfinite(passed) || (independent && !std::isfinite(whole))) return SolveStatus::failed;
    const Block block = first_block();
    const double step = std::min(whole, block.step);
    if (step == infinity) {
      if (excess > relative(implied_tolerance, level(limit))) {
        return contradicted(limit) ? SolveStatus::infeasible : SolveStatus::failed;
      }
      (limit.is_bound ? bound_side_ : row_side_)[limit.index] = Side::implied;
      return SolveStatus::solved;
    }
    if (independent) {
      for (int k = 0; k < free_count_; ++k) v_[free_[k]] += step * dv_[free_[k]];
    }
    for (int k = 0; k < held_count_; ++k) z_[held_[k]] += step * dz_[held_[k]];
    for (int t = 0; t < active_count_; ++t) y_[t] += step * dy_[t];
    multiplier += step * limit.sign;
    if (whole <= block.step) {
      if (limit.is_bound) {
        hold_bound(limit, multiplier);
        rebuild_basis();
      } else {
        hold_row(limit, multiplier);
      }
      return SolveStatus::solved;
    }
    if (block.is_bound) {
      release_bound(block.position);
    } else {
      release_row(block.position);
    }
    rebuild_basis();
  }
  return SolveStatus::max_iter;
}

// Write what v, z and y change by for each unit of the limit's multiplier, in the direction that
// keeps the working set's equations; return whether v can change at all. With sign · a the limit's
// own gradient, u = −L⁻¹(sign · a) on the free variables, and u = Q c + rest:
//     dv = L⁻ᵀ rest,  dy = R⁻¹c,  dz = −(H dv + Kᵀdy + sign · a) on the variables held.
bool QPSolver::find_direction(const Limit& limit) {
  if (limit.is_bound) {
    const int position = place_of(limit.index);
    std::fill_n(reduced_.begin(), free_count_, 0.0);
    reduced_[position] = -limit.sign;
    factor_.forward(reduced_.data(), position);
  } else {
    reduce(row(limit.index), -limit.sign);
  }
  const bool independent = basis_.project(reduced_.data(), coefficients_.data());
  curvature_ = dot(reduced_.data(), reduced_.data(), free_count_);
  std::copy_n(coefficients_.begin(), active_count_, dy_.begin());
  basis_.solve(dy_.data());
  std::fill(dv_.begin(), dv_.end(), 0.0);
  if (independent) {
    std::copy_n(reduced_.begin(), free_count_, free_step_.begin());
    factor_.backward(free_step_.data());
    for (int k = 0; k < free_count_; ++k) dv_[free_[k]] = free_step_[k];
  }
  for (int k = 0; k < held_count_; ++k) {
    const int i = held_[k];
    double change = dot(program_->H + i * size_, dv_.data(), size_);
    for (int t = 0; t < active_count_; ++t) change += dy_[t] * row(active_[t])[i];
    if (!limit.is_bound) change += limit.sign * row(limit.index)[i];
    dz_[i] = -change;
  }
  return independent;
}

// Whether the direction proves that no v meets the limit and the working set: the multipliers'
// rates balance on every variable, sign · a + Kᵀdy + dz = 0, but for rounding (Farkas). With r left
// over, a v′ that meets them is at least excess/‖r‖ away.
bool QPSolver::contradicted(const Limit& limit) const {
  const double enough = violation(limit) / (farthest * size_);
  for (int k = 0; k < free_count_; ++k) {
    const int i = free_[k];
    double left = limit.is_bound ? (i == limit.index ? limit.sign : 0.0)
                                 : limit.sign * row(limit.index)[i];
    const double most = std::max(relative(balance_tolerance, left), enough);
    for (int t = 0; t < active_count_; ++t) left += dy_[t] * row(active_[t])[i];
    if (!(std::abs(left) <= most)) return false;  // nor does NaN balance
  }
  return true;
}

// Return the step at which the first multiplier comes down to 0, and whose it is.
QPSolver::Block QPSolver::first_block() const {
  double fastest = 1.0;
  for (int k = 0; k < held_count_; ++k) fastest = std::max(fastest, std::abs(dz_[held_[k]]));
  for (int t = 0; t < active_count_; ++t) fastest = std::max(fastest, std::abs(dy_[t]));
  Block first{infinity, true, 0};
  const auto look_at = [&](bool is_bound, int position, Side side, double value, double rate) {
    if (!one_sided(side) || sign_of(side) * rate >= -least_rate * fastest) return;
    const double step = std::max(0.0, -value / rate);
    if (step < first.step) first = {step, is_bound, position};
  };
  for (int k = 0; k < held_count_; ++k) {
    look_at(true, k, bound_side_[held_[k]], z_[held_[k]], dz_[held_[k]]);
  }
  for (int t = 0; t < active_count_; ++t) {
    look_at(false, t, row_side_[active_[t]], y_[t], dy_[t]);
  }
  return first;
}

// Return the place of a variable among the free ones, which it is one of.
int QPSolver::place_of(int i) const {
  return static_cast<int>(std::find(free_.begin(), free_.end(), i) - free_.begin());
}

double QPSolver::level(const Limit& limit) const {
  const Program& p = *program_;
  if (limit.is_bound) return limit.sign > 0.0 ? p.ub[limit.index] : p.lb[limit.index];
  return limit.sign > 0.0 ? row_upper(limit.index) : row_lower(limit.index);
}

double QPSolver::violation(const Limit& limit) const {
  const double value =
      limit.is_bound ? v_[limit.index] : dot(row(limit.index), v_.data(), size_);
  return limit.sign * (value - level(limit));
}

void QPSolver::hold_bound(const Limit& limit, double multiplier) {
  const int i = limit.index;
  const int place = place_of(i);
  factor_.remove(place);
  std::copy(free_.begin() + place + 1, free_.begin() + free_count_, free_.begin() + place);
  --free_count_;
  held_[held_count_++] = i;
  bound_side_[i] = limit.sign > 0.0 ? Side::upper : Side::lower;
  v_[i] = level(limit);
  z_[i] = multiplier;
  ++iterations_;
}

// Hold a row, whose direction `find_direction` has left in the reduced coordinates.
void QPSolver::hold_row(const Limit& limit, double multiplier) {
  basis_.append(reduced_.data(), coefficients_.data(), -limit.sign);
  const bool equal = row_lower(limit.index) == row_upper(limit.index);
  row_side_[limit.index] = equal ? Side::both : limit.sign > 0.0 ? Side::upper : Side::lower;
  y_[active_count_] = multiplier;
  active_[active_count_++] = limit.index;
  ++iterations_;
}

void QPSolver::release_bound(int position) {
  const int i = held_[position];
  held_[position] = held_[--held_count_];
  const double* column = program_->H + i * size_;
  for (int k = 0; k < free_count_; ++k) reduced_[k] = column[free_[k]];
  factor_.append(reduced_.data(), column[i]);
  free_[free_count_++] = i;
  bound_side_[i] = Side::none;
  z_[i] = 0.0;
  ++iterations_;
}

void QPSolver::release_row(int position) {
  row_side_[active_[position]] = Side::none;
  std::copy(active_.begin() + position + 1, active_.begin() + active_count_,
            active_.begin() + position);
  std::copy(y_.begin() + position + 1, y_.begin() + active_count_, y_.begin() + position);
  --active_count_;
  ++iterations_;
}

}  // namespace rmrc
