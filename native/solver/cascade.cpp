#include "solver/cascade.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.qp.cascade
constexpr double exact = 1e-12;          // EXACT
constexpr double sound = 1e-7;           // SOUND

// ATTEMPTS: what is added to the diagonal, and to the room of the rows.
constexpr struct { double more, wider; } attempts[] = {
    {0.0, 0.0},   {1e-9, 0.0}, {1e-7, 0.0}, {0.0, 1e-11},
    {0.0, 1e-10}, {1e-5, 0.0}, {0.0, 1e-8}, {0.0, 1e-7}};

}  // namespace

Cascade::Cascade(int size, const LevelSizes& sizes, int max_rows, int max_equalities,
                 int max_iterations)
    : size_(size),
      null_space_(std::max({sizes.rows, sizes.directed, max_equalities}), size),
      reduction_(sizes.directed, size, 2),
      ranked_(std::max({sizes.rows, sizes.directed, max_equalities}), size, 0),
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
  optima_.resize(static_cast<std::size_t>(sizes.levels) * size);
  directed_.resize(static_cast<std::size_t>(sizes.levels) * size);
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

SolveStatus Cascade::solve(const std::vector<Level>& levels, const Program& limits,
                      Clock::time_point end) {
  limits_ = &limits;
  end_ = end;
  iterations_ = 0;
  scale_ = 1.0;
  optimum_count_ = directed_count_ = 0;
  residuals_ = {};
  for (int i = 0; i < size_; ++i) v_[i] = std::min(std::max(0.0, limits.lb[i]), limits.ub[i]);
  std::fill(z_.begin(), z_.end(), 0.0);
  std::fill(y_.begin(), y_.end(), 0.0);
  free_count_ = size_;
  whole_ = true;
  SolveStatus status = enter();
  if (status != SolveStatus::solved) {
    residuals_ = {infinity, infinity, infinity};
    return status == SolveStatus::time_limit ? status : SolveStatus::infeasible;
  }
  status = descend(levels);
  residuals_.primal = std::max(residuals_.primal, passed());
  return status == SolveStatus::solved || status == SolveStatus::time_limit ? status : SolveStatus::max_iter;
}

SolveStatus Cascade::descend(const std::vector<Level>& levels) {
  QPSolver* solver = solvers_.data() + 1;
  bool begun = false;
  for (const Level& level : levels) {
    bool directed = false;
    for (const bool first : {true, false}) {
      if (!level.asked) continue;
      if (free_count_ == 0) return SolveStatus::solved;
      if (first && std::exchange(begun, true)) {
        std::copy_n(v_.begin(), size_, optima_.begin() + optimum_count_++ * size_);
      }
      const SolveStatus status = first ? fastest(level, solver[0]) : nearest(level, solver[1]);
      if (status != SolveStatus::solved) return status;
      // Where no direction was found, the least squares has taken over.
      if (first) ++directed_count_;
      if (first || !directed) {
        std::copy_n(v_.begin(), size_, directed_.begin() + (directed_count_ - 1) * size_);
      }
      if (first) directed = found_direction_;
    }
    solver += 2;
  }
  return SolveStatus::solved;
}

// Move v to the feasible point nearest to rest, and free what the equalities leave.
SolveStatus Cascade::enter() {
  const Program& limits = *limits_;
  if (!(passed() <= exact)) {  // nor if that is not a number
    std::fill_n(H_.begin(), size_ * size_, 0.0);
    for (int i = 0; i < size_; ++i) H_[i * size_ + i] = 1.0;
    std::fill_n(g_.begin(), size_, 0.0);
    std::copy_n(limits.lo, limits.rows, lo_.begin());
    std::copy_n(limits.hi, limits.rows, hi_.begin());
    Program nearest_to_rest = limits;
    nearest_to_rest.H = H_.data();
    nearest_to_rest.g = g_.data();
    nearest_to_rest.lo = lo_.data();
    nearest_to_rest.hi = hi_.data();
    const SolveStatus status = attempt(solvers_.front(), nearest_to_rest, size_, true);
    if (status != SolveStatus::solved) return status;
    std::copy_n(step_.begin(), size_, v_.begin());
  }
  return limits.equalities == 0 ? SolveStatus::solved
                                : keep_free(limits.E, limits.equalities, size_);
}

Program Cascade::program(int equalities) const {
  return {H_.data(), g_.data(), lb_.data(), ub_.data(),
          C_.data(), lo_.data(), hi_.data(), E_.data(),
          f_.data(), (whole_ ? 0 : size_) + limits_->rows, equalities};
}

// Solve a program, whose H, lo and hi are written here, in as many attempts as it takes. What is
// refusable may have no solution; of any other that is rounding.
SolveStatus Cascade::attempt(QPSolver& solver, const Program& written, int variables, bool refusable) {
  const double scale = std::max(1.0, std::sqrt(dot(written.g, written.g, variables)));
  solver.resize(variables);
  SolveStatus status = SolveStatus::failed;
  for (const auto& [more, wider] : attempts) {
    if (is_over(end_)) return SolveStatus::time_limit;
    for (int i = 0; i < variables; ++i) H_[i * variables + i] += more;
    for (int r = 0; r < written.rows; ++r) {
      lo_[r] -= wider;
      hi_[r] += wider;
    }
    status = solver.solve(written, end_);
    iterations_ += solver.iterations();
    if (status == SolveStatus::time_limit || (status == SolveStatus::infeasible && refusable)) return status;
    if (status != SolveStatus::solved) continue;
    std::copy_n(solver.v(), variables, step_.begin());
    const Residuals kkt =
        certify(variables, written, solver.bound_multiplier(), solver.row_multiplier(),
                solver.equality_multiplier(), step_.data(), residual_.data());
    if (!(kkt.primal < sound && std::max(kkt.dual, kkt.complementarity) < sound * scale)) {
      status = SolveStatus::max_iter;
      solver.forget();
      continue;
    }
    residuals_ = {std::max(residuals_.primal, kkt.primal), std::max(residuals_.dual, kkt.dual),
                  std::max(residuals_.complementarity, kkt.complementarity)};
    return status;
  }
  return status;
}

// Solve a level's program as it is written, and take over the multipliers.
SolveStatus Cascade::certified(QPSolver& solver, int variables, int equalities, double share) {
  const Residuals before = residuals_;
  const SolveStatus status = attempt(solver, program(equalities), variables, false);
  if (status != SolveStatus::solved) return status;
  residuals_.dual = std::max(before.dual, share * residuals_.dual);
  residuals_.complementarity = std::max(before.complementarity, share * residuals_.complementarity);
  const double* y = solver.row_multiplier();
  if (whole_) {
    for (int i = 0; i < size_; ++i) z_[i] += share * solver.bound_multiplier()[i];
  } else {
    for (int i = 0; i < size_; ++i) z_[i] += share * y[i] / norm_[i];
    y += size_;
  }
  const double* norm = norm_.data() + (whole_ ? 0 : size_);
  for (int r = 0; r < limits_->rows; ++r) y_[r] += share * y[r] / norm[r];
  return status;
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

// Keep free only what rows, `stride` from one to the next, map to zero. Where it is not clear what
// that is, it is where their singular values say so.
SolveStatus Cascade::keep_free(const double* rows, int given, int stride) {
  const int before = free_count_;
  for (int r = 0; r < given; ++r) std::copy_n(rows + r * stride, before, null_space_.row(r));
  int count = null_space_.find(given, before, rank_share);
  if (count < 0) {
    for (int r = 0; r < given; ++r) std::copy_n(rows + r * stride, before, ranked_.row(r));
    const int rank = ranked_.reduce(given, before, rank_share);
    for (int r = 0; r < rank; ++r) {
      const double* row = ranked_.row(r);
      const double length = std::sqrt(dot(row, row, before));
      for (int i = 0; i < before; ++i) null_space_.row(r)[i] = row[i] / length;
    }
    count = null_space_.find(rank, before, rank_share);
  }
  if (count < 0) return SolveStatus::failed;
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
  return SolveStatus::solved;
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
