#include "tasks/foreign_rows.hpp"

#include <numeric>
#include <utility>

namespace rmrc {

namespace {

std::vector<int> all_dofs(int nv) {
  std::vector<int> dofs(nv);
  std::iota(dofs.begin(), dofs.end(), 0);
  return dofs;
}

}  // namespace

ForeignRows::ForeignRows(TermData data, std::vector<double> root, const MuJoCo& mujoco,
                         const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads(all_dofs(mujoco.nv)), mujoco, stack) {}

void ForeignRows::read() {
  const int count = static_cast<int>(dofs_.size());
  for (int r = 0; r < data_.rows; ++r) {
    const double* given = stack_.jacobian + (data_.first + r) * mujoco_.nv;
    double* own = jacobian_.data() + r * stride_;
    for (int k = 0; k < count; ++k) own[k] = given[dofs_[k]];
  }
  weigh();
}

}  // namespace rmrc
