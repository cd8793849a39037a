// The equalities E v = f of a step: what the hard tasks ask for, in independent rows.
#pragma once

#include <vector>

#include "solver/row_reduction.hpp"
#include "tasks/row_term.hpp"

namespace rmrc {

/// A hard task, J v = ẋ along the directions that it means.
struct HardTerm {
  int first, rows;                 // where its error and its rows stand
  std::vector<double> directions;  // orthonormal (r, rows)
  bool joint;                      // whether J is the identity
  std::vector<double> axis;        // a (3,) of a term that points it; or none
  bool bends;                      // whether it may be a cost in place of an equality
};

/// Where the equalities of a step stand, arrays with room for all directions of the hard tasks.
struct EqualityArrays {
  double *matrix, *right, *multiplier;  // E (capacity, n), f and w (capacity,)
};

/// Stacks J v = ẋ of the hard tasks, and takes out what is redundant: rmrc.qp.equalities.
class Equalities {
 public:
  /// `dofs` (n,) are the columns of J that count, `still` (n,) those among them that are zero.
  Equalities(const Stack& stack, const double* rate, int nv, std::vector<int> dofs,
             std::vector<char> still, std::vector<HardTerm> terms, const EqualityArrays& arrays);

  /// Find E and f at the present evaluation, for ẋ of all terms, or of those that do not bend.
  /// The dofs that are to stand still move at the lower bounds lb (n,), which are the upper ones.
  void update(bool without_bending, const double* lower);

  /// Write the shortest v (n,) with E v = f.
  void least_norm(double* v) const;

  int capacity() const { return capacity_; }
  int count() const { return count_; }
  const EqualityArrays& arrays() const { return arrays_; }

  /// Whether there is more than rounding in ẋ that no v gives.
  bool inconsistent() const { return inconsistent_; }

 private:
  int stack_up(const HardTerm& term, int at, const double* lower);
  void ask(const HardTerm& term, double* wanted) const;

  const Stack& stack_;
  const double* rate_;
  int nv_;
  std::vector<int> dofs_;
  std::vector<char> still_;
  std::vector<HardTerm> terms_;
  EqualityArrays arrays_;
  int capacity_;
  RowReduction reduction_;
  std::vector<double> wanted_;  // ẋ of one task
  int count_ = 0;
  bool inconsistent_ = false;
};

}  // namespace rmrc
