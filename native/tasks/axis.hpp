// `look_at` and `axis_align` tasks.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// e = s (d − a) for an axis a of a frame and the direction d of its target, with the stretch s of
/// `Stretch`: `look_at`, whose target is a point, and `axis_align`, whose target is a direction.
class Axis final : public RowTerm {
 public:
  Axis(TermData data, std::vector<double> root, Frame frame, const double* axis, bool at_point,
       const MuJoCo& mujoco, const Stack& stack);
  void measure(double* measures) const override;

 private:
  void differentiate() override;
  void look_at(double* T, double* direction);
  void align(double* T, double* direction);
  Frame frame_;
  double axis_[3];
  bool at_point_;
};

}  // namespace rmrc
