// Terms with rows that are evaluated elsewhere.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// Rows whose e, ẋ_ff and J others write into the stack, before `read`.
class ForeignRows final : public RowTerm {
 public:
  ForeignRows(TermData data, std::vector<double> root, const MuJoCo& mujoco, const Stack& stack);

  void evaluate() override {}

  /// Take J over from the stack, and weigh it.
  void read();

 private:
  void differentiate() override {}
};

}  // namespace rmrc
