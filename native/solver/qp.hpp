// The quadratic program of a step, and a dual active-set solver for it.
#pragma once

#include <cstdint>
#include <vector>

#include "base/clock.hpp"
#include "base/memory.hpp"
#include "solver/cholesky.hpp"
#include "solver/row_basis.hpp"
#include "solver/status.hpp"

namespace rmrc {

/// min_v ½ vᵀHv + gᵀv  s.t.  lb ≤ v ≤ ub, lo ≤ C v ≤ hi, E v = f.
///
/// Arrays of the caller, matrices by rows: H (n, n) symmetric positive definite, g, lb, ub (n,),
/// C (rows, n), lo, hi (rows,), E (equalities, n), f (equalities,). A limit that is absent is ±∞.
struct Program {
  const double* H;
  const double* g;
  const double* lb;
  const double* ub;
  const double* C;
  const double* lo;
  const double* hi;
  const double* E;
  const double* f;
  int rows;
  int equalities;
  /// What the rows are known by from one program to the next (rows,), in ascending order; by their
  /// index if it is null.
  const std::int64_t* keys = nullptr;
};

/// At which of its limits a bound or a row is held.
enum class Side : std::int8_t {
  lower = -1,
  none = 0,
  upper = 1,
  both,    // the two limits are equal: its multiplier may have either sign
  implied  // not held: the others keep it at its limit, but for rounding
};

/// Solves one program after the other, each from the active set of the last.
///
/// A dual active-set method (Goldfarb and Idnani 1983) on the variables that are not at a bound:
/// a bound that is active is a variable less, not a row more. `native/README.md` has the method.
/// All memory is taken by the constructor.
class QPSolver {
 public:
  /// Allocate for programs of `size` variables, up to `max_rows` rows and `max_equalities`.
  QPSolver(int size, int max_rows, int max_equalities, int max_iterations);

  /// Solve a program, whose arrays must hold for as long as the call, before the clock says `end`.
  ///
  /// After any answer but `solved`, v and the multipliers are 0. The next solve then starts cold,
  /// but for one that had no time: it goes on from where this one got to.
  SolveStatus solve(const Program& program, Clock::time_point end = Clock::time_point::max());

  /// Go on with programs of another size, up to that of the constructor; the next solve is cold.
  void resize(int size);

  /// Forget the active set: the next solve starts cold.
  void forget();

  /// Go through what the next solve starts from: the working set.
  void keep(Memory& memory);

  int size() const { return size_; }
  int max_rows() const { return max_rows_; }
  int max_equalities() const { return max_equalities_; }

  /// v (n,) of the last solve, and its multipliers: Hv + g + z + Cᵀy + Eᵀw = 0, each ≥ 0 at an
  /// upper limit and ≤ 0 at a lower one.
  const double* v() const { return v_.data(); }
  const double* bound_multiplier() const { return z_.data(); }
  const double* row_multiplier() const { return row_multiplier_.data(); }
  const double* equality_multiplier() const { return row_multiplier_.data() + rows_; }

  /// H v + g (n,) at that very v; null where rows are active, or where there is no solution.
  const double* gradient() const {
    return solved_ && active_count_ == 0 ? residual_.data() : nullptr;
  }

  /// Changes of the active set in the last solve.
  int iterations() const { return iterations_; }

 private:
  // A bound or a row: rows are C's, then E's.
  struct Limit {
    bool is_bound;
    int index;
    double sign;  // 1 where the upper limit is passed, −1 where the lower one is
  };

  // Where the first multiplier on the way comes down to 0: of the bound or row held at `position`.
  struct Block {
    double step;
    bool is_bound;
    int position;
  };

  bool finite() const;
  void find_rows_again();
  bool read_limits();
  SolveStatus run();
  SolveStatus finish();
  void factorize();
  void rebuild_basis();
  void reduce(const double* a, double scale);

  void settle(bool from_rest);
  double residuals();
  void correct();

  bool release_pushed_back(double tolerance);
  bool most_violated(double tolerance, Limit& found) const;
  SolveStatus enforce(const Limit& limit);
  bool find_direction(const Limit& limit);
  bool contradicted(const Limit& limit) const;
  Block first_block() const;
  int place_of(int i) const;
  double level(const Limit& limit) const;
  double violation(const Limit& limit) const;
  void hold_bound(const Limit& limit, double multiplier);
  void hold_row(const Limit& limit, double multiplier);
  void release_bound(int position);
  void release_row(int position);
  void rest();

  const double* row(int r) const {
    return r < rows_ ? program_->C + r * size_ : program_->E + (r - rows_) * size_;
  }
  double row_lower(int r) const { return r < rows_ ? program_->lo[r] : program_->f[r - rows_]; }
  double row_upper(int r) const { return r < rows_ ? program_->hi[r] : program_->f[r - rows_]; }
  double bound_at(int i) const {
    return bound_side_[i] == Side::lower ? program_->lb[i] : program_->ub[i];
  }
  double row_at(int r) const { return row_side_[r] == Side::lower ? row_lower(r) : row_upper(r); }

  int size_, max_rows_, max_equalities_, max_iterations_;
  const Program* program_ = nullptr;
  int rows_ = 0, equalities_ = 0;
  int iterations_ = 0;
  bool warm_ = false, solved_ = false;
  Clock::time_point end_;

  // The working set: the free variables in the order of the factor, the bounds held, the rows held.
  std::vector<int> free_, held_, active_;
  int free_count_ = 0, held_count_ = 0, active_count_ = 0;
  std::vector<Side> bound_side_, row_side_;
  std::vector<std::int64_t> keys_;  // of the rows of the last program that had any
  int key_count_ = 0;
  std::vector<Side> side_before_;

  Cholesky factor_;  // of H on the free variables
  RowBasis basis_;   // of the rows held

  std::vector<double> v_, z_, y_;  // y of the rows held, in their order
  std::vector<double> row_multiplier_;
  std::vector<double> residual_, misfit_;  // of stationarity (n) and of the rows held
  double gradient_ = 0.0, steepest_ = 0.0;  // the largest of g, and of H
  double scale_ = 0.0;  // of the terms of H v + g, what residuals and multipliers are measured by

  // The step towards a limit: what v, z and y change by for each unit of its multiplier.
  std::vector<double> dv_, dz_, dy_, free_step_, reduced_, coefficients_;
  double curvature_ = 0.0;  // −sign · aᵀdv = dvᵀH dv
};

}  // namespace rmrc
