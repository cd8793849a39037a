// Rows and equalities that cannot hold together: the least by which they have to give way.
#pragma once

#include <vector>

#include "base/clock.hpp"
#include "solver/qp.hpp"

namespace rmrc {

/// Finds the v of a box that violates rows and equalities least: rmrc.qp.relax.
///
///     min ½‖s‖² + ½‖t‖²  s.t.  lb ≤ v ≤ ub,  lo ≤ C v + s ≤ hi,  E v + t = f,
///                              −max(0, C b − hi) ≤ s ≤ max(0, lo − C b)
///
/// with b a brake, which no row is violated more than by. The slack is no variable here: what is
/// left is piecewise quadratic in v, and Newton's method with an exact line search goes down from b.
/// All memory is taken by the constructor.
class LeastViolation {
 public:
  LeastViolation(int size, int max_rows, int max_equalities);

  /// Find it for the limits of a program, whose cost is not read, before the clock says `end`.
  ///
  /// Return false if the time is over, or a number is not finite.
  bool find(const Program& limits, const double* brake, Clock::time_point end);

  /// v (n,) of the last call.
  const double* v() const { return v_.data(); }

  /// ‖[s; t]‖ there.
  double violation() const;

  /// Write lo, hi (rows,) and f (equalities,) moved by as much as v needs.
  void relax(double* lower, double* upper, double* right) const;

 private:
  double excess(int r, double activity) const;
  void assemble();
  SolveStatus solve(double rest, Clock::time_point end);
  double slope(double share) const;
  double search() const;
  bool agrees() const;
  void follow(const double* x, std::vector<double>& rows, std::vector<double>& equalities) const;

  int size_;
  Program limits_{};
  QPSolver solver_;
  std::vector<double> v_, step_;                   // (n,)
  std::vector<double> at_, change_, floor_, ceil_;  // C v and C step, and what s leaves of C v (rows,)
  std::vector<double> missed_, changed_;           // E v − f and E step (equalities,)
  // The program of a step.
  std::vector<double> H_, g_, lb_, ub_, lo_, hi_;
};

}  // namespace rmrc
