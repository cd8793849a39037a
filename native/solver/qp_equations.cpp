// The equations of a working set: factorized, and solved by refinement.

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/kernels.hpp"
#include "base/numbers.hpp"
#include "solver/qp.hpp"
#include "solver/qp_limits.hpp"

namespace rmrc {

namespace {

// Residual of the working set's equations, relative to their terms, that needs no refinement.
constexpr double resolution = 16.0 * epsilon;
constexpr int refinements = 5;

double largest(const double* x, int n) {
  double found = 0.0;
  for (int i = 0; i < n; ++i) found = std::max(found, std::abs(x[i]));
  return found;
}

}  // namespace

// Factorize at the sides as they are: equalities first, so that of rows that depend on
// each other it is those that stay. What finds no place is checked as any other limit.
void QPSolver::factorize() {
  free_count_ = held_count_ = active_count_ = 0;
  for (int i = 0; i < size_; ++i) {
    if (held(bound_side_[i])) {
      held_[held_count_++] = i;
    } else {
      free_[free_count_++] = i;
    }
  }
  factor_.factorize(program_->H, size_, free_.data(), free_count_);
  for (const bool equality : {true, false}) {
    for (int r = 0; r < rows_ + equalities_; ++r) {
      if (!held(row_side_[r]) || equality != (row_side_[r] == Side::both)) continue;
      if (active_count_ == free_count_) {
        row_side_[r] = Side::none;
        continue;
      }
      y_[active_count_] = 0.0;
      active_[active_count_++] = r;
    }
  }
  rebuild_basis();
}

// Bring the rows held into the basis anew, without those that depend on the ones before.
void QPSolver::rebuild_basis() {
  basis_.clear(free_count_);
  int kept = 0;
  for (int t = 0; t < active_count_; ++t) {
    reduce(row(active_[t]), 1.0);
    if (!basis_.project(reduced_.data(), coefficients_.data())) {
      row_side_[active_[t]] = Side::none;
      continue;
    }
    basis_.append(reduced_.data(), coefficients_.data(), 1.0);
    active_[kept] = active_[t];
    y_[kept++] = y_[t];
  }
  active_count_ = kept;
}

// Write L⁻¹(scale · a) on the free variables, or 0 where a is nothing but rounding there.
void QPSolver::reduce(const double* a, double scale) {
  for (int k = 0; k < free_count_; ++k) reduced_[k] = scale * a[free_[k]];
  const double left = dot(reduced_.data(), reduced_.data(), free_count_);
  if (left <= least_rate * least_rate * dot(a, a, size_)) {
    std::fill_n(reduced_.begin(), free_count_, 0.0);
  } else {
    factor_.forward(reduced_.data());
  }
}

// Solve the equations of the working set,
//     H v + g + Kᵀy = 0 on the free variables,  v = its limit on the others,  K v = d,
// from rest or from v and y as they are. Solving is refining: the same step from anywhere.
void QPSolver::settle(bool from_rest) {
  for (int k = 0; k < held_count_; ++k) v_[held_[k]] = bound_at(held_[k]);
  if (from_rest) {
    for (int k = 0; k < free_count_; ++k) v_[free_[k]] = 0.0;
    std::fill_n(y_.begin(), active_count_, 0.0);
    gradient_ = std::numeric_limits<double>::min();
    steepest_ = 0.0;
    for (int i = 0; i < size_; ++i) {
      gradient_ = std::max(gradient_, std::abs(program_->g[i]));
      steepest_ = std::max(steepest_, program_->H[i * size_ + i]);
    }
  }
  double before = infinity;
  for (int k = 0; k <= refinements; ++k) {
    const double size = residuals();
    if (size <= resolution || size > 0.5 * before || k == refinements) break;
    before = size;
    correct();
  }
  for (int k = 0; k < held_count_; ++k) z_[held_[k]] = -residual_[held_[k]];
}

// Write the residuals of the working set's equations and return the largest, relative.
double QPSolver::residuals() {
  const Program& p = *program_;
  double* residual = residual_.data();
  std::copy_n(p.g, size_, residual);
  int j = 0;
  for (; j + 4 <= size_; j += 4) {
    const double* four = v_.data() + j;
    const bool any = four[0] != 0.0 || four[1] != 0.0 || four[2] != 0.0 || four[3] != 0.0;
    if (any) add_four_scaled(four, p.H + j * size_, size_, residual, size_);
  }
  for (; j < size_; ++j) {
    if (v_[j] != 0.0) add_scaled(v_[j], p.H + j * size_, residual, size_);
  }
  double misfit = 0.0;
  for (int t = 0; t < active_count_; ++t) {
    const double* a = row(active_[t]);
    if (y_[t] != 0.0) add_scaled(y_[t], a, residual, size_);
    const double level = row_at(active_[t]);
    misfit_[t] = level - dot(a, v_.data(), size_);
    misfit = std::max(misfit, std::abs(misfit_[t]) / std::max(1.0, std::abs(level)));
  }
  scale_ = std::max(gradient_, steepest_ * largest(v_.data(), size_));
  double size = 0.0;
  for (int k = 0; k < free_count_; ++k) size = std::max(size, std::abs(residual[free_[k]]));
  return std::max(size / scale_, misfit);
}

// One step on the residuals. With x = Lᵀdv and the rows' own QR, L⁻¹Kᵀ = Q R:
//     x + Q R dy = −L⁻¹r,  Rᵀ Qᵀx = misfit.
void QPSolver::correct() {
  for (int k = 0; k < free_count_; ++k) reduced_[k] = -residual_[free_[k]];
  factor_.forward(reduced_.data());
  if (active_count_ > 0) {
    basis_.multiply_transposed(reduced_.data(), dy_.data());
    basis_.solve_transposed(misfit_.data());
    for (int t = 0; t < active_count_; ++t) dy_[t] -= misfit_[t];
    basis_.subtract(dy_.data(), reduced_.data());
    basis_.solve(dy_.data());
    for (int t = 0; t < active_count_; ++t) y_[t] += dy_[t];
  }
  factor_.backward(reduced_.data());
  for (int k = 0; k < free_count_; ++k) v_[free_[k]] += reduced_[k];
}

}  // namespace rmrc
