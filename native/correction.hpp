// The second-order correction of rows that the curvature of a step would break.
#pragma once

#include <vector>

#include "rows.hpp"

namespace rmrc {

/// Asks rows for what a command fell short of where it leads: rmrc.control.correct.
class Correction {
 public:
  explicit Correction(const Rows& rows) : rows_(rows), raised_(rows.capacity()) {}

  /// Begin with nothing missing.
  void begin();

  /// See what rows fall short of at an end that is as far away as v goes in a time, s; where the
  /// distance there is one of other points, have their row, if it may `foresee`.
  void see(const Kinematics& end, double time, bool foresee);

  /// Whether barriers have other functions that hold there; and whether anything is missing.
  bool jumped() const { return jumped_; }
  bool any() const { return jumped_ || missing_; }

  /// Raise lo of the rows (count,) by what is missing, inside a box lb, ub (n,).
  void raise_rows(const double* lb, const double* ub, double* lower) const;

 private:
  double fastest(int row, const double* lb, const double* ub) const;

  const Rows& rows_;
  bool jumped_ = false, missing_ = false;
  std::vector<double> raised_;  // what lo of each row rises by, rad/s or m/s
};

}  // namespace rmrc
