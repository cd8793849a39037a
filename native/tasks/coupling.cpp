#include "tasks/coupling.hpp"

#include <utility>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

std::vector<int> nonzero(const std::vector<double>& values) {
  std::vector<int> found;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i] != 0.0) found.push_back(static_cast<int>(i));
  }
  return found;
}

}  // namespace

Coupling::Coupling(TermData data, std::vector<double> root, std::vector<double> by_coordinate,
                   const std::vector<double>& by_dof, double offset, const MuJoCo& mujoco,
                   const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads(nonzero(by_dof)), mujoco, stack),
      by_coordinate_(std::move(by_coordinate)),
      offset_(offset) {
  for (std::size_t k = 0; k < dofs_.size(); ++k) jacobian_[k] = by_dof[dofs_[k]];
}

void Coupling::differentiate() {
  error()[0] = offset_ - dot(by_coordinate_.data(), mujoco_.qpos, mujoco_.nq);
}

}  // namespace rmrc
