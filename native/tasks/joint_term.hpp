// Terms on the joints themselves: `posture`, `velocity`, `smooth`, and foreign ones.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// What a term on the joints themselves asks for; e and ẋ_ff of a foreign one are written by others.
enum class JointTask { posture, velocity, smooth, foreign };

/// A term whose Jacobian is the identity; its weight is in the constant part of H.
struct JointTerm {
  TermData data;
  JointTask task;
  std::vector<double> weight;  // B: (nv,) a diagonal or (nv, nv)
  std::vector<int> wrapped;    // dofs of a posture that take the short way round

  /// Write e and ẋ_ff.
  void evaluate(const MuJoCo& mujoco, const Stack& stack) const;

  /// Return element i of B x (nv,).
  double weighed(int i, const double* x) const;

  /// Whether the term has a weight.
  bool counts() const;

  /// gradient ← gradient − B ẋ (nv,).
  void add_to(double* gradient, const double* rate) const;
};

}  // namespace rmrc
