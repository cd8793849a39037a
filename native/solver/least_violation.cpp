#include "solver/least_violation.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double room = 1e-9;  // rmrc.qp.relax.ROOM
// Weights of ‖step‖² beside the largest of the violations': the next where a solve fails.
constexpr double rests[] = {1e-10, 1e-7, 1e-4};
constexpr int most_steps = 100;
constexpr int most_changes = 10000;  // of the working set in each
// What a step has to gain of the violation, and of its share, at least.
constexpr double least_gain = 1e-20;
constexpr double least_share = 1e-18;
constexpr double settled = 1e-6;  // share of the violation's square below which it is not repeated
constexpr int most_looks = 60;  // at the slope along a step
constexpr double flat = 1e-9;   // share of the slope at its beginning that is none

}  // namespace

LeastViolation::LeastViolation(int size, int max_rows, int max_equalities)
    : size_(size),
      solver_(size, max_rows, 0, most_changes),
      v_(size),
      step_(size),
      at_(max_rows),
      change_(max_rows),
      floor_(max_rows),
      ceil_(max_rows),
      missed_(max_equalities),
      changed_(max_equalities),
      H_(static_cast<std::size_t>(size) * size),
      g_(size),
      lb_(size),
      ub_(size),
      lo_(max_rows),
      hi_(max_rows) {}

bool LeastViolation::find(const Program& limits, const double* brake,
                          Clock::time_point end) {
  limits_ = limits;
  std::copy_n(brake, size_, v_.begin());
  follow(brake, at_, missed_);
  for (int r = 0; r < limits.equalities; ++r) missed_[r] -= limits.f[r];
  for (int r = 0; r < limits.rows; ++r) {
    floor_[r] = std::min(limits.lo[r], at_[r]);
    ceil_[r] = std::max(limits.hi[r], at_[r]);
  }
  solver_.forget();
  for (int k = 0; k < most_steps; ++k) {
    const double before = violation();
    if (!std::isfinite(before)) return false;
    if (before == 0.0) return true;
    assemble();
    SolveStatus status = SolveStatus::failed;
    for (const double rest : rests) {
      status = solve(rest, end);
      if (status == SolveStatus::solved || status == SolveStatus::time_limit) break;
    }
    if (status == SolveStatus::time_limit) return false;
    if (status != SolveStatus::solved) return true;  // v is no worse than the brake
    std::copy_n(solver_.v(), size_, step_.begin());
    follow(step_.data(), change_, changed_);
    const double gain = -dot(g_.data(), step_.data(), size_);
    if (!(gain > least_gain + least_share * before * before)) return true;
    const double share = search();
    // On the piece that it ends on a step is whole, but for what the small weight has kept back.
    if (share == 1.0 && agrees() && !(gain > settled * before * before)) k = most_steps;
    for (int i = 0; i < size_; ++i) {
      v_[i] = std::min(std::max(v_[i] + share * step_[i], limits.lb[i]), limits.ub[i]);
    }
    follow(v_.data(), at_, missed_);
    for (int r = 0; r < limits.equalities; ++r) missed_[r] -= limits.f[r];
  }
  return true;
}

double LeastViolation::violation() const {
  double square = 0.0;
  for (int r = 0; r < limits_.rows; ++r) {
    const double by = excess(r, at_[r]);
    square += by * by;
  }
  return std::sqrt(square + dot(missed_.data(), missed_.data(), limits_.equalities));
}

void LeastViolation::relax(double* lower, double* upper, double* right) const {
  for (int r = 0; r < limits_.rows; ++r) {
    lower[r] = std::min(limits_.lo[r], at_[r] - room);
    upper[r] = std::max(limits_.hi[r], at_[r] + room);
  }
  for (int r = 0; r < limits_.equalities; ++r) right[r] = limits_.f[r] + missed_[r];
}

// By how much a row is outside its limits, less than 0 below them.
double LeastViolation::excess(int r, double activity) const {
  if (activity < limits_.lo[r]) return activity - limits_.lo[r];
  return activity > limits_.hi[r] ? activity - limits_.hi[r] : 0.0;
}

// Write C x and E x.
void LeastViolation::follow(const double* x, std::vector<double>& rows,
                            std::vector<double>& equalities) const {
  for (int r = 0; r < limits_.rows; ++r) rows[r] = dot(limits_.C + r * size_, x, size_);
  for (int r = 0; r < limits_.equalities; ++r) {
    equalities[r] = dot(limits_.E + r * size_, x, size_);
  }
}

// Write the gradient at v, the Hessian of the piece that v is on, and how far a step may go.
void LeastViolation::assemble() {
  const Program& p = limits_;
  std::fill(H_.begin(), H_.end(), 0.0);
  std::fill(g_.begin(), g_.end(), 0.0);
  const auto add = [&](const double* row, double missing) {
    add_scaled(missing, row, g_.data(), size_);
    for (int i = 0; i < size_; ++i) {
      if (row[i] != 0.0) add_scaled(row[i], row, H_.data() + i * size_, size_);
    }
  };
  for (int r = 0; r < p.rows; ++r) {
    const double by = excess(r, at_[r]);
    if (by != 0.0) add(p.C + r * size_, by);
    lo_[r] = std::min(floor_[r] - at_[r], 0.0);
    hi_[r] = std::max(ceil_[r] - at_[r], 0.0);
  }
  for (int r = 0; r < p.equalities; ++r) add(p.E + r * size_, missed_[r]);
  for (int i = 0; i < size_; ++i) {
    lb_[i] = std::min(p.lb[i] - v_[i], 0.0);
    ub_[i] = std::max(p.ub[i] - v_[i], 0.0);
  }
}

// Find the best step on that piece; a small weight keeps from it what gains nothing.
SolveStatus LeastViolation::solve(double rest, Clock::time_point end) {
  double largest = 0.0;
  for (int i = 0; i < size_; ++i) largest = std::max(largest, H_[i * size_ + i]);
  if (is_over(end)) return SolveStatus::time_limit;
  for (int i = 0; i < size_; ++i) H_[i * size_ + i] += rest * largest;
  const Program program{H_.data(), g_.data(), lb_.data(), ub_.data(),     limits_.C,  lo_.data(),
                        hi_.data(), nullptr,  nullptr,    limits_.rows, 0,           limits_.keys};
  return solver_.solve(program, end);
}

// The slope of ½‖[s; t]‖² at a share of the step.
double LeastViolation::slope(double share) const {
  double sum = 0.0;
  for (int r = 0; r < limits_.rows; ++r) {
    sum += excess(r, at_[r] + share * change_[r]) * change_[r];
  }
  for (int r = 0; r < limits_.equalities; ++r) {
    sum += (missed_[r] + share * changed_[r]) * changed_[r];
  }
  return sum;
}

// Return the share of the step at which the violation is least: its slope only grows along it.
double LeastViolation::search() const {
  const double first = slope(0.0);
  double low = 0.0, slope_low = first, high = 1.0, slope_high = slope(1.0);
  if (slope_high <= flat * std::abs(first)) return 1.0;
  for (int k = 0; k < most_looks; ++k) {
    // Regula falsi, and every other time the middle.
    const double part = k % 2 == 0 ? slope_low / (slope_low - slope_high) : 0.5;
    const double share = low + part * (high - low), found = slope(share);
    if (std::abs(found) <= flat * std::abs(first)) return share;
    (found < 0.0 ? low : high) = share;
    (found < 0.0 ? slope_low : slope_high) = found;
  }
  return low;
}

// Whether the piece that the step was found on is the one it leads to, but for rounding: there is
// nothing to gain then by another.
bool LeastViolation::agrees() const {
  for (int r = 0; r < limits_.rows; ++r) {
    const double by = excess(r, at_[r]), end = at_[r] + change_[r];
    const double linear = by == 0.0 ? 0.0 : by + change_[r];
    if (std::abs(linear - excess(r, end)) > room) return false;
  }
  return true;
}

}  // namespace rmrc
