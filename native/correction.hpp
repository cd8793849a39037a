// The second-order correction of rows that the curvature of a step would break.
#pragma once

#include <vector>

#include "rows.hpp"

namespace rmrc {

/// Asks rows for what a step fell short of at its end: rmrc.control.correct.
class Correction {
 public:
  explicit Correction(const Rows& rows);

  /// Write lo of the rows, raised where a step of dt that ends at `end` falls short, inside a box
  /// lb, ub (n,); return whether any does.
  bool raise_rows(const Kinematics& end, const double* lb, const double* ub, double dt);

  /// What was written last (count,).
  const double* lower() const { return lower_.data(); }

 private:
  bool raise_block(const Block& block, const Kinematics& end, double dt);
  double fastest(int row, const double* lb, const double* ub) const;

  const Rows& rows_;
  std::vector<double> lower_;
};

}  // namespace rmrc
