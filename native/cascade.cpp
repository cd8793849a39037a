#include "cascade.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "kernels.hpp"

namespace rmrc {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
// rmrc.qp.cascade
constexpr double rank_share = 1e-9;      // RANK
constexpr double fastest_weight = 1e-10;  // FASTEST
constexpr double polished = 1e-10;       // POLISHED
constexpr double still = 1e-8;           // STILL
constexpr double exact = 1e-12;          // EXACT

double largest(const Residuals& kkt) {
  return std::max({kkt.primal, kkt.dual, kkt.complementarity});
}

}  // namespace

Cascade::Cascade(int size, const LevelSizes& sizes, int max_rows, int max_equalities,
                 int max_iterations)
    : size_(size),
      null_space_(std::max({sizes.rows, sizes.directed, max_equalities}), size),
      reduction_(sizes.directed, size, 2),
      v_(size),
      z_(size),
      y_(max_rows),
      free_(static_cast<std::size_t>(size) * size),
      next_(free_.size()),
      norm_(size + max_rows),
      H_(static_cast<std::size_t>(size + 1) * (size + 1)),
      g_(size + 1),
      lb_(size + 1),
      ub_(size + 1),
      C_(static_cast<std::size_t>(size + max_rows) * (size + 1)),
      lo_(size + max_rows),
      hi_(size + max_rows),
      E_(static_cast<std::size_t>(std::max(sizes.directed, max_equalities)) * (size + 1)),
      f_(std::max(sizes.directed, max_equalities)),
      step_(size + 1),
      residual_(size + 1),
      reach_(static_cast<std::size_t>(std::max(sizes.rows, sizes.directed)) * size),
      missing_(std::max(sizes.rows, sizes.directed)) {
  solvers_.emplace_back(size, max_rows, max_equalities, max_iterations);
  for (int k = 0; k < sizes.levels; ++k) {
    solvers_.emplace_back(size + 1, size + max_rows, sizes.directed, max_iterations);
    solvers_.emplace_back(size, size + max_rows, 0, max_iterations);
  }
}

void Cascade::forget() {
  for (QPSolver& solver : solvers_) solver.forget();
}

void Cascade::keep(Memory& memory) {
  for (QPSolver& solver : solvers_) solver.keep(memory);
}

bool Cascade::solve(const std::vector<Level>& levels, const Program& limits,
                    QPSolver::Clock::time_point end) {
  limits_ = &limits;
  end_ = end;
  iterations_ = 0;
  scale_ = 1.0;
  residuals_ = {};
  for (int i = 0; i < size_; ++i) v_[i] = std::min(std::max(0.0, limits.lb[i]), limits.ub[i]);
  std::fill(z_.begin(), z_.end(), 0.0);
  std::fill(y_.begin(), y_.end(), 0.0);
  free_count_ = size_;
  whole_ = true;
  if (!enter()) return false;
  QPSolver* solver = solvers_.data() + 1;
  for (const Level& level : levels) {
    if (free_count_ == 0) break;
    if (!fastest(level, solver[0])) return false;
    if (free_count_ == 0) break;
    if (!nearest(level, solver[1])) return false;
    solver += 2;
  }
  residuals_.primal = std::max(residuals_.primal, passed());
  return std::isfinite(largest(residuals_));
}

// Move v to the feasible point nearest to rest, and free what the equalities leave.
bool Cascade::enter() {
  const Program& limits = *limits_;
  if (!(passed() <= exact)) {  // nor if that is not a number
    std::fill_n(H_.begin(), size_ * size_, 0.0);
    for (int i = 0; i < size_; ++i) H_[i * size_ + i] = 1.0;
    std::fill_n(g_.begin(), size_, 0.0);
    Program whole = limits;
    whole.H = H_.data();
    whole.g = g_.data();
    QPSolver& solver = solvers_.front();
    if (solver.solve(whole, end_) != Status::solved) return false;
    std::copy_n(solver.v(), size_, v_.begin());
    residuals_ = certify(size_, whole, solver.bound_multiplier(), solver.row_multiplier(),
                         solver.equality_multiplier(), v_.data(), residual_.data());
    if (!(largest(residuals_) <= polished)) return false;
  }
  if (limits.equalities == 0) return true;
  for (int r = 0; r < limits.equalities; ++r) {
    std::copy_n(limits.E + r * size_, size_, null_space_.row(r));
  }
  return keep_free(limits.equalities);
}

// Maximise α in J (v + N z) = α ẋ, 0 ≤ α ≤ 1, of the part of ẋ that the free motion can give.
bool Cascade::fastest(const Level& level, QPSolver& solver) {
  const int count = free_count_, variables = count + 1;
  if (level.directed == 0) return true;
  for (int r = 0; r < level.directed; ++r) {
    const double* own = level.jacobian + r * size_;
    double* row = reduction_.row(r);
    reduce(own, row);
    row[count] = level.direction[r];
    row[count + 1] = dot(own, v_.data(), size_);
  }
  const int rank = reduction_.reduce(level.directed, count, rank_share);
  bool wanted = false;
  for (int r = 0; r < rank; ++r) {
    const double* row = reduction_.row(r);
    std::copy_n(row, count, E_.begin() + r * variables);
    E_[r * variables + count] = -row[count];
    f_[r] = -row[count + 1];
    wanted |= row[count] != 0.0;
  }
  if (!wanted) return true;
  std::fill_n(H_.begin(), variables * variables, 0.0);
  for (int i = 0; i < count; ++i) H_[i * variables + i] = fastest_weight;
  H_[count * variables + count] = 1.0;
  reduce(v_.data(), g_.data());
  for (int i = 0; i < count; ++i) g_[i] *= fastest_weight;
  g_[count] = -1.0;
  bound(variables);
  lb_[count] = 0.0;
  ub_[count] = 1.0;
  if (!certified(solver, variables, rank)) return false;
  scale_ = std::min(scale_, step_[count]);
  advance();
  for (int r = 0; r < rank; ++r) std::copy_n(reduction_.row(r), count, null_space_.row(r));
  return keep_free(rank);
}

// Solve a level's least squares, but for rows that nothing free moves.
bool Cascade::nearest(const Level& level, QPSolver& solver) {
  const int count = free_count_;
  double square = 0.0;
  for (int r = 0; r < level.rows; ++r) {
    const double* own = level.matrix + r * size_;
    double* row = reach_.data() + r * count;
    reduce(own, row);
    missing_[r] = dot(own, v_.data(), size_) - level.rate[r];
    square += dot(row, row, count);
  }
  if (level.rows > 0 && square <= rank_share * rank_share) return true;
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
  if (!certified(solver, count, 0)) return false;
  advance();
  for (int r = 0; r < level.rows; ++r) {
    std::copy_n(reach_.data() + r * count, count, null_space_.row(r));
  }
  return keep_free(level.rows);
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

Program Cascade::program(int equalities) const {
  return {H_.data(), g_.data(), lb_.data(), ub_.data(),
          C_.data(), lo_.data(), hi_.data(), E_.data(),
          f_.data(), (whole_ ? 0 : size_) + limits_->rows, equalities};
}

// Solve the program as it is written; return whether the answer is as good as a polished one.
bool Cascade::certified(QPSolver& solver, int variables, int equalities) {
  const Program written = program(equalities);
  solver.resize(variables);
  const Status status = solver.solve(written, end_);
  iterations_ += solver.iterations();
  if (status != Status::solved) return false;
  std::copy_n(solver.v(), variables, step_.begin());
  const Residuals kkt =
      certify(variables, written, solver.bound_multiplier(), solver.row_multiplier(),
              solver.equality_multiplier(), step_.data(), residual_.data());
  if (!(largest(kkt) <= polished)) return false;
  residuals_ = {std::max(residuals_.primal, kkt.primal), std::max(residuals_.dual, kkt.dual),
                std::max(residuals_.complementarity, kkt.complementarity)};
  const double* y = solver.row_multiplier();
  if (whole_) {
    for (int i = 0; i < size_; ++i) z_[i] += solver.bound_multiplier()[i];
  } else {
    for (int i = 0; i < size_; ++i) z_[i] += y[i] / norm_[i];
    y += size_;
  }
  const double* norm = norm_.data() + (whole_ ? 0 : size_);
  for (int r = 0; r < limits_->rows; ++r) y_[r] += y[r] / norm[r];
  return true;
}

// Add N z to v.
void Cascade::advance() {
  for (int k = 0; k < free_count_; ++k) {
    if (whole_) {
      v_[k] += step_[k];
    } else {
      add_scaled(step_[k], free_.data() + k * size_, v_.data(), size_);
    }
  }
  for (int i = 0; i < size_; ++i) {
    v_[i] = std::min(std::max(v_[i], limits_->lb[i]), limits_->ub[i]);
  }
}

// Keep free only what the rows given to the null space map to zero.
bool Cascade::keep_free(int rows) {
  const int before = free_count_;
  const int count = null_space_.find(rows, before, rank_share);
  if (count < 0) return false;
  for (int k = 0; k < count; ++k) {
    const double* inside = null_space_.vector(k);
    double* vector = next_.data() + k * size_;
    if (whole_) {
      std::copy_n(inside, size_, vector);
      continue;
    }
    std::fill_n(vector, size_, 0.0);
    for (int i = 0; i < before; ++i) {
      add_scaled(inside[i], free_.data() + i * size_, vector, size_);
    }
  }
  std::swap(free_, next_);
  free_count_ = count;
  whole_ = false;
  return true;
}

// out = Nᵀx.
void Cascade::reduce(const double* x, double* out) const {
  if (whole_) {
    std::copy_n(x, size_, out);
    return;
  }
  for (int k = 0; k < free_count_; ++k) out[k] = dot(free_.data() + k * size_, x, size_);
}

// By how much v passes the rows or misses the equalities, at most.
double Cascade::passed() const {
  const Program& limits = *limits_;
  double worst = 0.0;
  for (int r = 0; r < limits.rows; ++r) {
    const double at = dot(limits.C + r * size_, v_.data(), size_);
    const double by = std::max(limits.lo[r] - at, at - limits.hi[r]);
    if (!(by <= worst)) worst = by;
  }
  for (int r = 0; r < limits.equalities; ++r) {
    const double by = std::abs(dot(limits.E + r * size_, v_.data(), size_) - limits.f[r]);
    if (!(by <= worst)) worst = by;
  }
  return worst;
}

}  // namespace rmrc
