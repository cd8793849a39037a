#include "tasks/centre_of_mass.hpp"

#include <algorithm>
#include <utility>

#include "base/lie.hpp"

namespace rmrc {

namespace {

Reads reads_of(const std::vector<MovedMass>& moved, const std::vector<Subtree>& subtrees) {
  std::vector<int> dofs;
  for (const MovedMass& part : moved) dofs.push_back(part.dof);
  Reads reads(std::move(dofs));
  for (const MovedMass& part : moved) reads.add(part.point).add(part.reference);
  for (const Subtree& subtree : subtrees) {
    reads.add(subtree.point, subtree.carrier).add(subtree.reference);
  }
  return reads;
}

}  // namespace

CentreOfMass::CentreOfMass(TermData data, std::vector<double> root, std::vector<MovedMass> moved,
                           std::vector<Subtree> subtrees, const MuJoCo& mujoco,
                           const Stack& stack)
    : RowTerm(std::move(data), std::move(root), reads_of(moved, subtrees), mujoco, stack),
      moved_(std::move(moved)),
      subtrees_(std::move(subtrees)) {
  std::stable_partition(moved_.begin(), moved_.end(),
                        [&](const MovedMass& part) { return stack.place[part.dof] >= 0; });
}

void CentreOfMass::differentiate() {
  std::copy_n(data_.target, 3, error());
  for (const Subtree& subtree : subtrees_) {
    for (int i = 0; i < 3; ++i) error()[i] -= subtree.share * subtree.point[i];
    if (subtree.carrier == nullptr) continue;
    double velocity[3];
    velocity_at(subtree.carrier, subtree.reference, subtree.point, velocity);
    for (int i = 0; i < 3; ++i) drift_[i] += subtree.share * velocity[i];
  }
  double *out = jacobian_.data(), *world = world_.data();
  for (const MovedMass& part : moved_) {
    const double* angular = mujoco_.cdof + 6 * part.dof;
    double offset[3], moved[3];
    for (int i = 0; i < 3; ++i) offset[i] = part.point[i] - part.reference[i];
    cross(angular, offset, moved);
    for (int i = 0; i < 3; ++i) {
      out[i * stride_] = world[i * stride_] = part.share * (angular[3 + i] + moved[i]);
    }
    ++out, ++world;
  }
  if (moves()) std::copy_n(data_.twist, 3, feedforward());
}

}  // namespace rmrc
