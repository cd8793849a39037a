// The programs of one level of a cascade: its directions, and its least squares.

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "base/numbers.hpp"
#include "solver/cascade.hpp"

namespace rmrc {

namespace {

// rmrc.qp.cascade
constexpr double worth = 1e-6;  // WORTH
constexpr double brisk = 10.0;  // BRISK
constexpr double lost = 0.02;   // LOST
constexpr double still = 1e-8;  // STILL

}  // namespace

// Maximise α in J (v + N z) = α ẋ, 0 ≤ α ≤ 1, of the part of ẋ that the free motion can give.
SolveStatus Cascade::fastest(const Level& level, QPSolver& solver) {
  const int count = free_count_, variables = count + 1;
  found_direction_ = false;
  if (level.directed == 0) return SolveStatus::solved;
  for (int r = 0; r < level.directed; ++r) {
    const double* own = level.jacobian + r * size_;
    double* row = reduction_.row(r);
    reduce(own, row);
    row[count] = level.direction[r];
    row[count + 1] = dot(own, v_.data(), size_);
  }
  const int rank = reduction_.reduce(level.directed, count, rank_share);
  if (rank == 0) return SolveStatus::solved;
  double square = 0.0, whole = 0.0, left = 0.0;
  for (int r = 0; r < level.directed; ++r) whole += level.direction[r] * level.direction[r];
  for (int r = 0; r < rank; ++r) {
    const double* row = reduction_.row(r);
    left += row[count] * row[count];
    const double sigma = std::sqrt(dot(row, row, count));
    double* unit = E_.data() + r * variables;
    for (int k = 0; k <= count; ++k) unit[k] = row[k] / sigma;
    square += unit[count] * unit[count];
    f_[r] = -row[count + 1] / sigma;
  }
  if (left < lost * lost * whole) return SolveStatus::solved;  // the least squares takes over
  const double least = std::sqrt(square);  // κ
  // t = κ α, so that all variables are rates; there is no way along ẋ = 0.
  for (int r = 0; r < rank; ++r) {
    double& along = E_[r * variables + count];
    along = least > 0.0 ? -along / least : 0.0;
  }
  std::fill_n(H_.begin(), variables * variables, 0.0);
  for (int i = 0; i < variables; ++i) H_[i * variables + i] = 1.0;
  reduce(v_.data(), g_.data());
  const double pull = std::min(least, brisk) / worth;
  g_[count] = -pull;
  bound(variables);
  lb_[count] = 0.0;
  ub_[count] = least;
  // In the unit of α, as that of a cost whose largest weight is 1.
  const double share = least * pull > 1.0 ? 1.0 / (least * pull) : 1.0;
  const SolveStatus status = certified(solver, variables, rank, share);
  if (status == SolveStatus::infeasible) return SolveStatus::solved;  // the least squares takes over
  if (status != SolveStatus::solved) return status;
  found_direction_ = true;
  if (least > 0.0) scale_ = std::min(scale_, step_[count] / least);
  advance();
  return keep_free(E_.data(), rank, variables);
}

// Solve a level's least squares, but for rows that nothing free moves.
SolveStatus Cascade::nearest(const Level& level, QPSolver& solver) {
  const int count = free_count_;
  double square = 0.0;
  for (int r = 0; r < level.rows; ++r) {
    const double* own = level.matrix + r * size_;
    double* row = reach_.data() + r * count;
    reduce(own, row);
    missing_[r] = dot(own, v_.data(), size_) - level.rate[r];
    square += dot(row, row, count);
  }
  if (level.rows > 0 && square <= rank_share * rank_share) return SolveStatus::solved;
  std::fill_n(H_.begin(), count * count, 0.0);
  if (level.metric == nullptr && level.curvature == nullptr) {
    reduce(v_.data(), g_.data());
    for (int i = 0; i < count; ++i) H_[i * count + i] = level.damping;
    for (int i = 0; i < count; ++i) g_[i] *= level.damping;
  } else {
    for (int i = 0; i < count; ++i) {
      weigh(level, whole_ ? nullptr : free_.data() + i * size_, i);
      reduce(step_.data(), H_.data() + i * count);
    }
    weigh(level, v_.data(), -1);
    reduce(step_.data(), g_.data());
  }
  for (int r = 0; r < level.rows; ++r) {
    const double* row = reach_.data() + r * count;
    for (int i = 0; i < count; ++i) {
      if (row[i] != 0.0) add_scaled(row[i], row, H_.data() + i * count, count);
    }
    add_scaled(missing_[r], row, g_.data(), count);
  }
  bound(count);
  const SolveStatus status = certified(solver, count, 0);
  if (status != SolveStatus::solved) return status;
  advance();
  return keep_free(reach_.data(), level.rows, count);
}

// step_ = (A + X) x of a level, or its column if x is null.
void Cascade::weigh(const Level& level, const double* x, int column) {
  for (int j = 0; j < size_; ++j) {
    const double own = x == nullptr ? (j == column ? 1.0 : 0.0) : x[j];
    if (level.metric == nullptr) {
      step_[j] = level.damping * own;
    } else {
      const double* row = level.metric + j * size_;
      step_[j] = x == nullptr ? row[column] : dot(row, x, size_);
    }
    if (level.curvature != nullptr) step_[j] += level.curvature[j] * own;
  }
}

// Write the limits of v + N z: as they are while all is free, as unit rows afterwards. Rounding
// must not shut out z = 0.
void Cascade::bound(int variables) {
  const Program& limits = *limits_;
  const int count = free_count_, first = whole_ ? 0 : size_;
  std::fill_n(lb_.begin(), variables, -infinity);
  std::fill_n(ub_.begin(), variables, infinity);
  for (int i = 0; i < size_; ++i) {
    const double low = std::min(limits.lb[i] - v_[i], 0.0);
    const double high = std::max(limits.ub[i] - v_[i], 0.0);
    (whole_ ? lb_ : lo_)[i] = low;
    (whole_ ? ub_ : hi_)[i] = high;
    double* row = C_.data() + i * variables;
    for (int k = 0; !whole_ && k < count; ++k) row[k] = free_[k * size_ + i];
  }
  for (int r = 0; r < limits.rows; ++r) {
    const double* own = limits.C + r * size_;
    const double at = dot(own, v_.data(), size_);
    lo_[first + r] = std::min(limits.lo[r] - at, 0.0);
    hi_[first + r] = std::max(limits.hi[r] - at, 0.0);
    reduce(own, C_.data() + (first + r) * variables);
  }
  for (int r = 0; r < first + limits.rows; ++r) {
    double* row = C_.data() + r * variables;
    std::fill_n(row + count, variables - count, 0.0);
    norm_[r] = 1.0;
    if (whole_) continue;
    const double length = std::sqrt(dot(row, row, count));
    if (length < still) {  // what the levels above have fixed is rounding, and no limit
      std::fill_n(row, count, 0.0);
      continue;
    }
    norm_[r] = length;
    for (int k = 0; k < count; ++k) row[k] /= length;
    lo_[r] /= length;
    hi_[r] /= length;
  }
}

}  // namespace rmrc
