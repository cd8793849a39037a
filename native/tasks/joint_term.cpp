#include "tasks/joint_term.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double full_turn = 2.0 * std::numbers::pi;

}  // namespace

void JointTerm::evaluate(const MuJoCo& mujoco, const Stack& stack) const {
  double *error = stack.error + data.first, *feedforward = stack.feedforward + data.first;
  switch (task) {
    case JointTask::posture:
      mujoco.call.differentiate_pos(mujoco.model, error, 1.0, mujoco.qpos, data.target);
      for (const int dof : wrapped) {
        error[dof] -= full_turn * std::ceil((error[dof] - std::numbers::pi) / full_turn);
      }
      break;
    case JointTask::velocity:
      for (int i = 0; i < mujoco.nv; ++i) error[i] = data.target[i] - stack.v_previous[i];
      std::copy_n(data.target, mujoco.nv, feedforward);
      break;
    case JointTask::smooth:
      std::copy_n(stack.v_previous, mujoco.nv, feedforward);
      break;
    case JointTask::foreign:
      break;
  }
}

double JointTerm::weighed(int i, const double* x) const {
  const int n = data.rows;
  return static_cast<int>(weight.size()) > n ? dot(weight.data() + i * n, x, n) : weight[i] * x[i];
}

bool JointTerm::counts() const {
  return std::any_of(weight.begin(), weight.end(), [](double value) { return value != 0.0; });
}

void JointTerm::add_to(double* gradient, const double* rate) const {
  for (int i = 0; i < data.rows; ++i) gradient[i] -= weighed(i, rate + data.first);
}

}  // namespace rmrc
