#include "solver/cascade.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
// rmrc.qp.cascade
constexpr double rank_share = 1e-9;      // RANK
constexpr double worth = 1e-6;  // WORTH
constexpr double brisk = 10.0;  // BRISK
constexpr double lost = 0.02;   // LOST
constexpr double still = 1e-8;           // STILL
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

Status Cascade::solve(const std::vector<Level>& levels, const Program& limits,
                      QPSolver::Clock::time_point end) {
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
  Status status = enter();
  if (status != Status::solved) {
    residuals_ = {infinity, infinity, infinity};
    return status == Status::time_limit ? status : Status::infeasible;
  }
  status = descend(levels);
  residuals_.primal = std::max(residuals_.primal, passed());
  return status == Status::solved || status == Status::time_limit ? status : Status::max_iter;
}

Status Cascade::descend(const std::vector<Level>& levels) {
  QPSolver* solver = solvers_.data() + 1;
  bool begun = false;
  for (const Level& level : levels) {
    bool directed = false;
    for (const bool first : {true, false}) {
      if (!level.asked) continue;
      if (free_count_ == 0) return Status::solved;
      if (first && std::exchange(begun, true)) {
        std::copy_n(v_.begin(), size_, optima_.begin() + optimum_count_++ * size_);
      }
      const Status status = first ? fastest(level, solver[0]) : nearest(level, solver[1]);
      if (status != Status::solved) return status;
      // Where no direction was found, the least squares has taken over.
      if (first) ++directed_count_;
      if (first || !directed) {
        std::copy_n(v_.begin(), size_, directed_.begin() + (directed_count_ - 1) * size_);
      }
      if (first) directed = found_direction_;
    }
    solver += 2;
  }
  return Status::solved;
}

// Move v to the feasible point nearest to rest, and free what the equalities leave.
Status Cascade::enter() {
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
    const Status status = attempt(solvers_.front(), nearest_to_rest, size_, true);
    if (status != Status::solved) return status;
    std::copy_n(step_.begin(), size_, v_.begin());
  }
  return limits.equalities == 0 ? Status::solved
                                : keep_free(limits.E, limits.equalities, size_);
}

// Maximise α in J (v + N z) = α ẋ, 0 ≤ α ≤ 1, of the part of ẋ that the free motion can give.
Status Cascade::fastest(const Level& level, QPSolver& solver) {
  const int count = free_count_, variables = count + 1;
  found_direction_ = false;
  if (level.directed == 0) return Status::solved;
  for (int r = 0; r < level.directed; ++r) {
    const double* own = level.jacobian + r * size_;
    double* row = reduction_.row(r);
    reduce(own, row);
    row[count] = level.direction[r];
    row[count + 1] = dot(own, v_.data(), size_);
  }
  const int rank = reduction_.reduce(level.directed, count, rank_share);
  if (rank == 0) return Status::solved;
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
  if (left < lost * lost * whole) return Status::solved;  // the least squares takes over
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
  const Status status = certified(solver, variables, rank, share);
  if (status == Status::infeasible) return Status::solved;  // the least squares takes over
  if (status != Status::solved) return status;
  found_direction_ = true;
  if (least > 0.0) scale_ = std::min(scale_, step_[count] / least);
  advance();
  return keep_free(E_.data(), rank, variables);
}

// Solve a level's least squares, but for rows that nothing free moves.
Status Cascade::nearest(const Level& level, QPSolver& solver) {
  const int count = free_count_;
  double square = 0.0;
  for (int r = 0; r < level.rows; ++r) {
    const double* own = level.matrix + r * size_;
    double* row = reach_.data() + r * count;
    reduce(own, row);
    missing_[r] = dot(own, v_.data(), size_) - level.rate[r];
    square += dot(row, row, count);
  }
  if (level.rows > 0 && square <= rank_share * rank_share) return Status::solved;
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
  const Status status = certified(solver, count, 0);
  if (status != Status::solved) return status;
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

Program Cascade::program(int equalities) const {
  return {H_.data(), g_.data(), lb_.data(), ub_.data(),
          C_.data(), lo_.data(), hi_.data(), E_.data(),
          f_.data(), (whole_ ? 0 : size_) + limits_->rows, equalities};
}

// Solve a program, whose H, lo and hi are written here, in as many attempts as it takes. What is
// refusable may have no solution; of any other that is rounding.
Status Cascade::attempt(QPSolver& solver, const Program& written, int variables, bool refusable) {
  const double scale = std::max(1.0, std::sqrt(dot(written.g, written.g, variables)));
  solver.resize(variables);
  Status status = Status::failed;
  for (const auto& [more, wider] : attempts) {
    if (is_over(end_)) return Status::time_limit;
    for (int i = 0; i < variables; ++i) H_[i * variables + i] += more;
    for (int r = 0; r < written.rows; ++r) {
      lo_[r] -= wider;
      hi_[r] += wider;
    }
    status = solver.solve(written, end_);
    iterations_ += solver.iterations();
    if (status == Status::time_limit || (status == Status::infeasible && refusable)) return status;
    if (status != Status::solved) continue;
    std::copy_n(solver.v(), variables, step_.begin());
    const Residuals kkt =
        certify(variables, written, solver.bound_multiplier(), solver.row_multiplier(),
                solver.equality_multiplier(), step_.data(), residual_.data());
    if (!(kkt.primal < sound && std::max(kkt.dual, kkt.complementarity) < sound * scale)) {
      status = Status::max_iter;
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
Status Cascade::certified(QPSolver& solver, int variables, int equalities, double share) {
  const Residuals before = residuals_;
  const Status status = attempt(solver, program(equalities), variables, false);
  if (status != Status::solved) return status;
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
Status Cascade::keep_free(const double* rows, int given, int stride) {
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
  if (count < 0) return Status::failed;
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
  return Status::solved;
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
