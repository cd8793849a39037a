// The second-order correction of rows that the curvature of a step would break.
#pragma once

#include "rows.hpp"

namespace rmrc {

/// Asks rows for what a step fell short of at its end: rmrc.control.correct.
class Correction {
 public:
  explicit Correction(const Rows& rows) : rows_(rows) {}

  /// Raise lo of the rows (count,) where a step of dt that ends at `end` falls short, inside a box
  /// lb, ub (n,); return whether any does.
  bool raise_rows(const Kinematics& end, const double* lb, const double* ub, double dt,
                  double* lower) const;

 private:
  bool raise_block(const Block& block, const Kinematics& end, double dt, double* lower) const;
  double fastest(int row, const double* lb, const double* ub) const;

  const Rows& rows_;
};

}  // namespace rmrc
