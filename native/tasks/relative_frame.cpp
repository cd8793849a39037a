#include "tasks/relative_frame.hpp"

#include <algorithm>
#include <utility>

#include "base/lie.hpp"
#include "tasks/motion.hpp"

namespace rmrc {

RelativeFrame::RelativeFrame(TermData data, std::vector<double> root, Frame frame, Frame base,
                             const MuJoCo& mujoco, const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads().add(frame).add(base), mujoco, stack),
      frame_(std::move(frame)),
      base_(std::move(base)) {}

void RelativeFrame::measure(double* measures) const { measure_motion(error(), measures); }

void RelativeFrame::differentiate() {
  const double *Rf = frame_.rotation, *Rb = base_.rotation;
  double qf[4], qb[4], relative[4], away[3], place[3];
  quaternion_of(Rf, qf);
  quaternion_of(Rb, qb);
  conjugate_multiply(qb, qf, relative);  // T_bf: the frame in the coordinates of its base
  for (int i = 0; i < 3; ++i) away[i] = frame_.position[i] - base_.position[i];
  rotate_back(Rb, away, place);
  // e = log(T_ft), for T_tf = T_bt⁻¹ T_bf
  double turned[4], gap[3], R[9], translation[3];
  conjugate_multiply(relative, data_.target, turned);
  for (int i = 0; i < 3; ++i) gap[i] = data_.target[4 + i] - place[i];
  transposed_multiply3(Rb, Rf, R);
  rotate_back(R, gap, translation);
  log_motion(turned, translation, error());
  double A[9], B[9], AR[9], BR[9], T[36];
  inverse_left_jacobian_motion(error(), A, B);
  multiply_transposed3(A, Rf, AR);
  multiply_transposed3(B, Rf, BR);
  set_blocks(T, AR, BR, AR);
  move(frame_);
  carry(base_, frame_.position);
  turn(T);
  if (!moves()) return;
  // Jlog(T_tf) Ad(T_ft) V_t with the target's twist in its own axes: rotated into the frame's, and
  // taken at the frame's origin.
  double rigid[6], lever[3], at_frame[6];
  std::copy_n(data_.twist, 6, rigid);
  for (int i = 0; i < 3; ++i) gap[i] = -gap[i];
  cross(rigid + 3, gap, lever);
  for (int i = 0; i < 3; ++i) rigid[i] += lever[i];
  rotate_back(R, rigid, at_frame);
  rotate_back(R, rigid + 3, at_frame + 3);
  for (int i = 0; i < 3; ++i) {
    feedforward()[i] = dot3(A + 3 * i, at_frame) + dot3(B + 3 * i, at_frame + 3);
    feedforward()[3 + i] = dot3(A + 3 * i, at_frame + 3);
  }
}

}  // namespace rmrc
