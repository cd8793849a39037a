// The way of a command, and of the steps after it in which the joints brake.
#pragma once

#include <vector>

#include "limits/box.hpp"

namespace rmrc {

/// The way of a step with v, and of those after it, in which the joints brake:
/// rmrc.engine.backtracking._Path.
///
/// Its places are counted in steps: 0 is the present configuration, 1 where v leads, and at `last`
/// all joints rest.
class Path {
 public:
  /// The limits of the joints must live as long.
  explicit Path(const JointLimits& limits);

  /// Begin the way of v (n,) in steps of dt at q (nq,), or where no range ends if it is null.
  void set_out(const double* v, double dt, const double* q);

  /// Write how far the joints have moved at a place (n,).
  void way(double place, double* way) const;

  int size() const { return static_cast<int>(speed_.size()); }
  double last() const { return last_; }

  /// Whether each joint comes to rest.
  bool slows() const { return slows_; }

  /// Return how far a joint moves in the first step.
  double first(int joint) const { return speed_[joint] * dt_; }

  /// Return the largest |q̇| and |q̈| of a joint after a place.
  double speed(int joint, double place) const {
    return steps_[joint] >= place ? speed_[joint] - place * change_[joint] : 0.0;
  }
  double turn(int joint, double place) const {
    return steps_[joint] >= place ? change_[joint] / dt_ : 0.0;
  }

 private:
  const JointLimits* limits_;
  bool slows_;
  double dt_ = 0.0, last_ = 1.0;
  // Of each joint its sign and speed, the whole steps it takes to rest, and the change in each.
  std::vector<double> sign_, speed_, steps_, change_;
};

}  // namespace rmrc
