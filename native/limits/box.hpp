// The box of the joint limits: rmrc.limits.box and .jerk, the same roundings included.
#pragma once

#include <vector>

namespace rmrc {

/// The limits of the joints (n,), as in rmrc.limits.box.Box; ±∞ where there is none.
struct JointLimits {
  std::vector<int> coordinate;  // address in qpos
  std::vector<double> lower, upper;
  double gain;
  std::vector<double> velocity, acceleration, jerk;
  std::vector<double> step;  // most that a joint moves in a step
};

/// Write the steps of dt that v (n,) takes to rest once a step with it is over, and by how much |v|
/// falls in each, as braking of rmrc.limits.box; from q (nq,), or where no range ends if it
/// is null.
void braking(const JointLimits& limits, const double* v, double dt, const double* q, double* steps,
             double* change);

/// Write what is left of v (n,), which has led to q (nq,), after a step of braking: braked of
/// rmrc.limits.box.
void braked(const JointLimits& limits, const double* v, double dt, const double* q, double* left);

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
