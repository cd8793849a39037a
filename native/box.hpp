// The box of the joint limits: rmrc.problem.limits.box and .jerk, the same roundings included.
#pragma once

#include <vector>

namespace rmrc {

/// The limits of the joints (n,), as in rmrc.problem.limits.box.Box; ±∞ where there is none.
struct JointLimits {
  std::vector<int> coordinate;  // address in qpos
  std::vector<double> lower, upper;
  double gain;
  std::vector<double> velocity, acceleration, jerk;
  std::vector<double> step;  // most that a joint moves in a step
  std::vector<int> balls;    // the first of the three entries of each ball joint
};

/// Write the steps of dt that |v| (n,) takes to rest, and by how much it falls in each, as braking
/// of rmrc.problem.limits.box.
void braking(const std::vector<double>& acceleration, const std::vector<int>& balls,
             const double* speed, double dt, double* steps, double* change);

/// Computes lb ≤ v ≤ ub of a step: position, velocity and acceleration clip the ends in this order.
class Box {
 public:
  explicit Box(JointLimits limits);

  /// Write lb and ub (n,) at q, after a step with v_previous and a_previous (n,).
  ///
  /// Return whether a joint is outside its range.
  bool update(const double* q, const double* v_previous, const double* a_previous, double dt,
              double* lb, double* ub) const;

  const JointLimits& limits() const { return limits_; }

 private:
  JointLimits limits_;
};

}  // namespace rmrc
