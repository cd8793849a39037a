// `com` tasks.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// What a dof moves of a centre of mass: a share of the mass, whose own centre is at `point`.
struct MovedMass {
  int dof;
  double share;
  const double* point;      // (3,)
  const double* reference;  // (3,)
};

/// A subtree, whose share of the mass has its centre at `point`.
struct Subtree {
  double share;
  const double *point, *reference, *carrier;  // of the latter two see `Frame`
};

/// e = c* − Σ share c_i over subtrees: a `com` task.
class CentreOfMass final : public RowTerm {
 public:
  CentreOfMass(TermData data, std::vector<double> root, std::vector<MovedMass> moved,
               std::vector<Subtree> subtrees, const MuJoCo& mujoco, const Stack& stack);

 private:
  void differentiate() override;
  std::vector<MovedMass> moved_;
  std::vector<Subtree> subtrees_;
};

}  // namespace rmrc
