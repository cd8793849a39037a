// End-effector speed: the norm of a frame's velocity, by planes and by the curvature of the ball.
#pragma once

#include <vector>

#include "kinematics/frame.hpp"
#include "kinematics/mujoco.hpp"

namespace rmrc {

/// Planes that may stand for one ball: rmrc.limits.speed.PLANES.
constexpr int planes = 12;

/// ‖J v‖ ≤ V for one half of a frame's velocity, J (3, n): rmrc.limits.speed._Ball.
class SpeedBall {
 public:
  SpeedBall(double largest, int n) : largest_(largest), jacobian_(3 * n), n_(n) {}

  double* jacobian() { return jacobian_.data(); }
  double largest() const { return largest_; }
  double curvature() const { return curvature_; }

  void begin(const double (&directions)[2][3], double* rows, double* upper);
  bool cut(const double* v, const double* y, double* rows, double* upper);

  /// H ← H + μ Jᵀ(I − uuᵀ)J (n, n).
  void bend(double* H) const;

  /// Write J v (3,); return its length.
  double velocity(const double* v, double* moved) const;

 private:
  bool add(const double* direction, double* rows, double* upper);

  double largest_, curvature_ = 0.0;
  std::vector<double> jacobian_;
  int n_, used_ = 0;
  bool bent_ = false;
  double directions_[planes][3]{}, direction_[3]{};
};

/// Rows uᵀ J v ≤ ρ of a frame: rmrc.limits.speed.SpeedRows.
class SpeedRows {
 public:
  /// `rate` is the task's ẋ (6,), along the frame's own axes if `turned`; ∞ without a limit. `place`
  /// (nv,) are the columns of the dofs, −1 where one stands still; `v_previous` is (nv,).
  SpeedRows(Frame frame, bool turned, double linear, double angular, const double* rate,
            const double* v_previous, const int* place, int n, const double* cdof);

  /// The frame whose velocity is limited.
  const Frame& frame() const { return frame_; }

  int count() const { return planes * static_cast<int>(balls_.size()); }

  /// Write uᵀJ (count, n) and hi (count,).
  void write(double* rows, double* upper);

  /// Change rows, hi or curvature where v (n,) is too fast; return whether anything has changed. The
  /// curvature is changed with the multipliers y (count,), which may be null.
  bool cut(const double* v, const double* y, double* rows, double* upper);

  void bend(double* H) const;

  /// By how much v (n,) moves the frame too fast, at most; ≤ 0 if it does not.
  double excess(const double* v) const;

  /// The largest s ≤ 1 for which b + s (v − b) is no faster than the frame may be; 0 where b is.
  double share(const double* brake, const double* v) const;

 private:
  Frame frame_;
  bool turned_;
  std::vector<SpeedBall> balls_;
  std::vector<int> at_;  // where in ẋ each half begins
  const double *rate_, *v_previous_;
  const int* place_;
  int n_;
  const double* cdof_;
};

}  // namespace rmrc
