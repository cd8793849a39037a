// `relative_frame` tasks.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// e = −log(T_tf) of a frame in the coordinates of another: a `relative_frame` task.
class RelativeFrame final : public RowTerm {
 public:
  RelativeFrame(TermData data, std::vector<double> root, Frame frame, Frame base,
                const MuJoCo& mujoco, const Stack& stack);
  void measure(double* measures) const override;

 private:
  void differentiate() override;
  Frame frame_, base_;
};

}  // namespace rmrc
