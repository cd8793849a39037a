// The second-order correction of rows that the curvature of a step would break.
#pragma once

#include <vector>

#include "limits/rows.hpp"

namespace rmrc {

/// Asks rows for what a command fell short of where it leads: rmrc.engine.correction.
class Correction {
 public:
  explicit Correction(const Rows& rows) : rows_(rows), raised_(rows.capacity()) {}

  /// Begin with nothing missing.
  void begin();

  /// See what rows fall short of at an end that is as far away as v goes in a time, s.
  void see(const Kinematics& end, double time);

  /// Raise lo of the rows (count,) by it, inside a box lb, ub (n,); return whether any fell short.
  bool raise_rows(const double* lb, const double* ub, double* lower) const;

 private:
  double fastest(int row, const double* lb, const double* ub) const;

  const Rows& rows_;
  std::vector<double> raised_;  // what lo of each row rises by, rad/s or m/s
};

}  // namespace rmrc
