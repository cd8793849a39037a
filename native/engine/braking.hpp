// Braking in time: rmrc.qp.braking.
#pragma once

#include <vector>

#include "limits/box.hpp"

namespace rmrc {

/// Slows down what drives the errors, so that no joint overshoots where it has limits to shed.
class Braking {
 public:
  explicit Braking(const JointLimits& limits);

  /// Whether any joint has something to shed its rate with, and whether one has a jerk limit.
  bool brakes() const { return brakes_; }
  bool jerks() const { return jerks_; }

  /// What drives the errors, Σ JᵀBKe (n,), and Σ JᵀBe (n,): filled before `slow`.
  double* driven() { return driven_.data(); }
  double* way() { return way_.data(); }

  /// Solve H v for both, H (n, n), with `gain` the largest K; return s, or −1 if H is singular.
  double slow(const double* H, double gain, double dt);

  /// Write the velocity (n,) that comes to s v inside the jerk limits.
  const double* followed(double share, const double* v_previous, double dt);

 private:
  bool factorize(const double* H);
  void solve(double* x) const;

  const JointLimits& limits_;
  bool brakes_, jerks_;
  std::vector<double> driven_, way_, v_, left_, slope_, factor_;
};

}  // namespace rmrc
