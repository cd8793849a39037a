// `coupling` tasks.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// e = offset − Σ c_i q_i and J = c: a `coupling` task.
class Coupling final : public RowTerm {
 public:
  Coupling(TermData data, std::vector<double> root, std::vector<double> by_coordinate,
           const std::vector<double>& by_dof, double offset, const MuJoCo& mujoco,
           const Stack& stack);

 private:
  void differentiate() override;
  std::vector<double> by_coordinate_;
  double offset_;
};

}  // namespace rmrc
