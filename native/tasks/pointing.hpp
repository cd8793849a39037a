// The error of an axis that points somewhere: rmrc.tasks.pointing.
#pragma once

namespace rmrc {

/// The angle θ that an error of this length stands for.
double pointing_angle(double length) noexcept;

/// How e = ρ(θ) n changes with the unit vector d (3,): M = ∂e/∂d = s I − μ n lᵀ.
class Stretch {
 public:
  /// For the axis a (3,) and d − a (3,).
  Stretch(const double* axis, const double* chord) noexcept;

  /// For the axis a (3,) and e (3,).
  static Stretch of_error(const double* axis, const double* error) noexcept;

  /// Whether M is I, up to a right angle.
  bool trivial() const { return trivial_; }

  /// e = s (d − a).
  double factor() const { return factor_; }

  /// x ← M x for x (3, n) by rows.
  void apply(double* x, int n) const noexcept;

  /// The unit vector at right angles to M x for every x at right angles to d.
  void normal(double* out) const noexcept;

 private:
  double direction_[3], along_[3] = {}, toward_[3] = {};
  double factor_ = 1.0, slope_ = 0.0, half_ = 0.0;
  bool trivial_ = true;
};

}  // namespace rmrc
