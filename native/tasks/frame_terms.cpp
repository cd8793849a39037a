#include "tasks/frame_terms.hpp"

#include <algorithm>
#include <utility>

#include "base/lie.hpp"
#include "tasks/motion.hpp"

namespace rmrc {

namespace {

// out = T x for T (rows, 6).
void apply(const double* T, int rows, const double* x, double* out) {
  for (int i = 0; i < rows; ++i) {
    double sum = 0.0;
    for (int j = 0; j < 6; ++j) sum += T[6 * i + j] * x[j];
    out[i] = sum;
  }
}

}  // namespace

BodyFrame::BodyFrame(TermData data, std::vector<double> root, Frame frame, const MuJoCo& mujoco,
                     const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads().add(frame), mujoco, stack),
      frame_(std::move(frame)) {}

void BodyFrame::measure(double* measures) const { measure_motion(error(), measures); }

void BodyFrame::differentiate() {
  const double *quaternion = data_.target, *position = data_.target + 4, *R = frame_.rotation;
  double own[4], turned[4], away[3], translation[3];
  quaternion_of(R, own);
  conjugate_multiply(own, quaternion, turned);
  for (int i = 0; i < 3; ++i) away[i] = position[i] - frame_.position[i];
  rotate_back(R, away, translation);
  log_motion(turned, translation, error());
  double A[9], B[9], AR[9], BR[9], T[36];
  inverse_left_jacobian_motion(error(), A, B);
  multiply_transposed3(A, R, AR);
  multiply_transposed3(B, R, BR);
  set_blocks(T, AR, BR, AR);
  move(frame_);
  turn(T);
  if (!moves()) return;
  // What the frame would have to do to move with the target as one rigid body.
  double rigid[6], lever[3];
  std::copy_n(data_.twist, 6, rigid);
  for (int i = 0; i < 3; ++i) away[i] = -away[i];
  cross(rigid + 3, away, lever);
  for (int i = 0; i < 3; ++i) rigid[i] += lever[i];
  apply(T, 6, rigid, feedforward());
}

WorldFrame::WorldFrame(TermData data, std::vector<double> root, Frame frame, const MuJoCo& mujoco,
                       const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads().add(frame), mujoco, stack),
      frame_(std::move(frame)) {}

void WorldFrame::measure(double* measures) const {
  measures[0] = norm3(error());
  measures[1] = norm3(error() + 3);
}

void WorldFrame::differentiate() {
  double own[4], turned[4], back[3], A[9], T[36];
  for (int i = 0; i < 3; ++i) error()[i] = data_.target[4 + i] - frame_.position[i];
  quaternion_of(frame_.rotation, own);
  multiply_conjugate(data_.target, own, turned);
  log_rotation(turned, error() + 3);
  // Jr⁻¹(φ) = Jl⁻¹(−φ)
  for (int i = 0; i < 3; ++i) back[i] = -error()[3 + i];
  inverse_left_jacobian(back, A);
  constexpr double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, zero[9] = {};
  set_blocks(T, unit, zero, A);
  move(frame_);
  turn(T);
  if (!moves()) return;
  std::copy_n(data_.twist, 3, feedforward());
  rotate_back(A, data_.twist + 3, feedforward() + 3);
}

}  // namespace rmrc
