// End-effector speed: the norm of a frame's velocity, as rows of the program.
#pragma once

#include <vector>

#include "mujoco.hpp"
#include "tasks.hpp"

namespace rmrc {

/// Rows |uᵢᵀ J v| ≤ bᵢ of a frame: rmrc.problem.limits.speed.SpeedRows.
class SpeedRows {
 public:
  /// `rate` is the task's ẋ (6,), along the frame's own axes if `turned`; ∞ without a limit.
  SpeedRows(Frame frame, bool turned, double linear, double angular, const double* rate,
            const double* cdof);

  int count() const { return 3 * halves_; }

  /// Write uᵀJ (count, n), the columns of `place` (nv,), and b (count,).
  void write(const int* place, int n, double* rows, double* bound) const;

 private:
  Frame frame_;
  bool turned_;
  int halves_;
  int at_[2];          // where in ẋ each half begins
  double largest_[2];  // the speed of each half
  const double *rate_, *cdof_;
};

}  // namespace rmrc
