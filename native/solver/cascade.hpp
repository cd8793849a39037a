// Strict priorities and preserved directions: rmrc.qp.cascade.
#pragma once

#include <limits>
#include <vector>

#include "base/clock.hpp"
#include "base/memory.hpp"
#include "solver/certificate.hpp"
#include "solver/null_space.hpp"
#include "solver/qp.hpp"
#include "solver/row_reduction.hpp"

namespace rmrc {

/// What one level of priority asks of v (n,).
struct Level {
  int rows;
  const double* matrix;  // W = S J (rows, n)
  const double* rate;    // S ẋ (rows,)
  const double* metric;  // added to WᵀW (n, n), or null for a multiple of the unit matrix
  double damping;        // that multiple
  const double* curvature;  // X of the level's tasks (n,), added as well; null for none
  int directed;
  const double* jacobian;   // J (directed, n) of the tasks that move along ẋ
  const double* direction;  // ẋ (directed,) of theirs
  bool asked = true;        // whether it counts at this step
};

/// The most that the levels of a problem have.
struct LevelSizes {
  int levels, rows, directed;
};

/// Solves levels one after another, each in the null space of those above, inside all limits.
///
/// All memory is taken by the constructor.
class Cascade {
 public:
  Cascade(int size, const LevelSizes& sizes, int max_rows, int max_equalities, int max_iterations);

  /// Find the lexicographic optimum inside the limits of a program, whose cost is not read, before
  /// the clock says `end`.
  ///
  /// `infeasible`: no v was found inside the limits, and the residuals are infinite. `max_iter`: a
  /// level could not be solved; v is the feasible optimum of those above it. `time_limit`: either
  /// of the two.
  SolveStatus solve(const std::vector<Level>& levels, const Program& limits,
               Clock::time_point end);

  /// Start the next solve cold.
  void forget();

  /// Go through what the next solve starts from.
  void keep(Memory& memory);

  const double* v() const { return v_.data(); }

  /// v (n,) of level k once its directions were found, before its other tasks were; null where it
  /// was not begun.
  const double* directed(int k) const {
    return k < directed_count_ ? directed_.data() + k * size_ : nullptr;
  }

  /// v_k (n,) of level k, counting those that were asked: the answer itself for the last that was
  /// solved, null for those behind it.
  const double* optimum(int k) const {
    return k < optimum_count_ ? optima_.data() + k * size_ : k == optimum_count_ ? v() : nullptr;
  }

  /// The multipliers of bounds and rows, summed over the levels.
  const double* bound_multiplier() const { return z_.data(); }
  const double* row_multiplier() const { return y_.data(); }

  /// The largest of the levels, and by how much v passes rows or misses equalities.
  const Residuals& residuals() const { return residuals_; }
  int iterations() const { return iterations_; }

  /// α, the least of all preserved directions.
  double scale() const { return scale_; }

 private:
  static constexpr double rank_share = 1e-9;  // rmrc.qp.cascade.RANK

  SolveStatus enter();
  SolveStatus descend(const std::vector<Level>& levels);
  SolveStatus fastest(const Level& level, QPSolver& solver);
  SolveStatus nearest(const Level& level, QPSolver& solver);
  void weigh(const Level& level, const double* x, int column);
  void bound(int variables);
  SolveStatus attempt(QPSolver& solver, const Program& program, int variables, bool refusable);
  SolveStatus certified(QPSolver& solver, int variables, int equalities, double share = 1.0);
  void advance();
  SolveStatus keep_free(const double* rows, int count, int stride);

  void reduce(const double* x, double* out) const;
  double passed() const;
  Program program(int equalities) const;

  int size_;
  std::vector<QPSolver> solvers_;  // to enter, then two of each level: fastest, nearest
  NullSpace null_space_;
  RowReduction reduction_, ranked_;
  const Program* limits_ = nullptr;
  Clock::time_point end_;

  std::vector<double> v_, z_, y_;
  int free_count_ = 0;
  bool whole_ = true;              // whether all is free, and the basis the unit matrix
  std::vector<double> free_;       // the basis N by columns (n, n)
  std::vector<double> next_;       // that of the level below
  std::vector<double> norm_;       // of the limits' rows in N
  Residuals residuals_{};
  int iterations_ = 0;
  double scale_ = 1.0;
  std::vector<double> optima_;  // v_k of the levels above the last that was begun
  std::vector<double> directed_;  // of those that were begun
  bool found_direction_ = false;
  int optimum_count_ = 0, directed_count_ = 0;

  // A level's program over z, and over α behind it.
  std::vector<double> H_, g_, lb_, ub_, C_, lo_, hi_, E_, f_;
  std::vector<double> step_, residual_;
  std::vector<double> reach_, missing_;
};

}  // namespace rmrc
