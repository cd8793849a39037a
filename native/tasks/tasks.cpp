#include "tasks/tasks.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "base/kernels.hpp"
#include "base/lie.hpp"
#include "tasks/pointing.hpp"

namespace rmrc {

namespace {

constexpr double least_length = 1e-10;  // a target nearer than this, m, has no direction
constexpr double least_angle = 1e-9;    // rad
constexpr double full_turn = 2.0 * std::numbers::pi;

// T ← [A 0; 0 D] in a matrix (6, 6).
void set_blocks(double* T, const double* A, const double* B, const double* D) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      T[6 * i + j] = A[3 * i + j];
      T[6 * i + 3 + j] = B[3 * i + j];
      T[6 * (i + 3) + j] = 0.0;
      T[6 * (i + 3) + 3 + j] = D[3 * i + j];
    }
  }
}

// out = T x for T (rows, 6).
void apply(const double* T, int rows, const double* x, double* out) {
  for (int i = 0; i < rows; ++i) {
    double sum = 0.0;
    for (int j = 0; j < 6; ++j) sum += T[6 * i + j] * x[j];
    out[i] = sum;
  }
}

double norm3(const double* v) { return std::sqrt(dot3(v, v)); }

std::vector<int> united(const std::vector<int>& a, const std::vector<int>& b) {
  std::vector<int> all(a);
  for (const int dof : b) {
    if (std::find(a.begin(), a.end(), dof) == a.end()) all.push_back(dof);
  }
  std::sort(all.begin(), all.end());
  return all;
}

std::vector<int> dofs_of(const std::vector<MovedMass>& moved) {
  std::vector<int> dofs;
  for (const MovedMass& part : moved) dofs.push_back(part.dof);
  return dofs;
}

std::vector<int> all_dofs(int nv) {
  std::vector<int> dofs(nv);
  std::iota(dofs.begin(), dofs.end(), 0);
  return dofs;
}

std::vector<int> nonzero(const std::vector<double>& values) {
  std::vector<int> found;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i] != 0.0) found.push_back(static_cast<int>(i));
  }
  return found;
}

// The distance and the angle that the logarithm e = log(T) of a motion stands for.
void measure_motion(const double* e, double* measures) {
  const double *rho = e, *omega = e + 3;
  const double angle = norm3(omega), square = dot3(rho, rho);
  measures[1] = angle;
  if (angle < least_angle) {
    measures[0] = std::sqrt(square);
    return;
  }
  const double projection = dot3(rho, omega) / angle, along = projection * projection;
  const double ratio = 2.0 * std::sin(0.5 * angle) / angle;
  measures[0] = std::sqrt(along + ratio * ratio * std::max(square - along, 0.0));
}

}  // namespace

BodyFrame::BodyFrame(TermData data, std::vector<double> root, Frame frame, const MuJoCo& mujoco,
                     const Stack& stack)
    : RowTerm(std::move(data), std::move(root), frame.dofs, mujoco, stack),
      frame_(std::move(frame)) {
  stand_on(frame_);
}

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
    : RowTerm(std::move(data), std::move(root), frame.dofs, mujoco, stack),
      frame_(std::move(frame)) {
  stand_on(frame_);
}

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

RelativeFrame::RelativeFrame(TermData data, std::vector<double> root, Frame frame, Frame base,
                             const MuJoCo& mujoco, const Stack& stack)
    : RowTerm(std::move(data), std::move(root), united(frame.dofs, base.dofs), mujoco, stack),
      frame_(std::move(frame)),
      base_(std::move(base)) {
  stand_on(frame_);
  stand_on(base_);
}

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

Axis::Axis(TermData data, std::vector<double> root, Frame frame, const double* axis, bool at_point,
           const MuJoCo& mujoco, const Stack& stack)
    : RowTerm(std::move(data), std::move(root), frame.dofs, mujoco, stack),
      frame_(std::move(frame)),
      at_point_(at_point) {
  std::copy_n(axis, 3, axis_);
  stand_on(frame_);
}

void Axis::measure(double* measures) const {
  measures[0] = measures[1] = pointing_angle(norm3(error()));
}

void Axis::differentiate() {
  double T[18], direction[3];
  if (at_point_) {
    look_at(T, direction);
  } else {
    align(T, direction);
  }
  for (int i = 0; i < 3; ++i) error()[i] = direction[i] - axis_[i];
  const Stretch stretch(axis_, error());
  if (!stretch.trivial()) {
    for (int i = 0; i < 3; ++i) error()[i] *= stretch.factor();
    stretch.apply(T, 6);
    if (moves()) stretch.apply(feedforward(), 1);
  }
  move(frame_);
  turn(T);
}

// d = Rᵀ(t − p)/n, whose rate is −(I − d dᵀ)(J_v − [nd]× J_ω)/n.
void Axis::look_at(double* T, double* direction) {
  const double* R = frame_.rotation;
  double away[3], toward[3];
  for (int i = 0; i < 3; ++i) away[i] = data_.target[i] - frame_.position[i];
  rotate_back(R, away, toward);
  const double length = norm3(toward), distance = distance_ = std::max(length, least_length);
  for (int i = 0; i < 3; ++i) direction[i] = toward[i] / distance;
  double across[9], turned[9];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      across[3 * i + j] = ((i == j) - direction[i] * direction[j]) / distance;
    }
  }
  multiply_transposed3(across, R, turned);
  for (int i = 0; i < 3; ++i) {
    double lever[3];
    // −[r]×Rᵀω = −Rᵀ(away × ω), and aᵀ(away × ω) = ωᵀ(a × away)
    cross(turned + 3 * i, away, lever);
    for (int j = 0; j < 3; ++j) {
      T[6 * i + j] = turned[3 * i + j];
      T[6 * i + 3 + j] = -lever[j];
    }
  }
  if (!moves()) return;
  double velocity[3];
  rotate_back(R, data_.twist, velocity);
  const double floor = std::max(length, least_angle);
  for (int i = 0; i < 3; ++i) toward[i] /= floor;
  const double along = dot3(toward, velocity);
  for (int i = 0; i < 3; ++i) feedforward()[i] = (velocity[i] - toward[i] * along) / floor;
}

// d = Rᵀt, whose rate is [d]× J_ω along the frame's axes.
void Axis::align(double* T, double* direction) {
  const double *R = frame_.rotation, *t = data_.target;
  rotate_back(R, t, direction);
  for (int i = 0; i < 3; ++i) {
    const double column[3] = {R[i], R[3 + i], R[6 + i]};
    double lever[3];
    // −[d]×Rᵀω = −Rᵀ(t × ω), and cᵀ(t × ω) = ωᵀ(c × t)
    cross(column, t, lever);
    for (int j = 0; j < 3; ++j) {
      T[6 * i + j] = 0.0;
      T[6 * i + 3 + j] = -lever[j];
    }
  }
  if (!moves()) return;
  double velocity[3];
  cross(data_.twist + 3, t, velocity);
  rotate_back(R, velocity, feedforward());
}

CentreOfMass::CentreOfMass(TermData data, std::vector<double> root, std::vector<MovedMass> moved,
                           std::vector<Subtree> subtrees, const MuJoCo& mujoco,
                           const Stack& stack)
    : RowTerm(std::move(data), std::move(root), dofs_of(moved), mujoco, stack),
      moved_(std::move(moved)),
      subtrees_(std::move(subtrees)) {
  for (const Subtree& subtree : subtrees_) carried_ |= subtree.carrier != nullptr;
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

Coupling::Coupling(TermData data, std::vector<double> root, std::vector<double> by_coordinate,
                   const std::vector<double>& by_dof, double offset, const MuJoCo& mujoco,
                   const Stack& stack)
    : RowTerm(std::move(data), std::move(root), nonzero(by_dof), mujoco, stack),
      by_coordinate_(std::move(by_coordinate)),
      offset_(offset) {
  for (std::size_t k = 0; k < dofs_.size(); ++k) jacobian_[k] = by_dof[dofs_[k]];
}

void Coupling::differentiate() {
  error()[0] = offset_ - dot(by_coordinate_.data(), mujoco_.qpos, mujoco_.nq);
}

ForeignRows::ForeignRows(TermData data, std::vector<double> root, const MuJoCo& mujoco,
                         const Stack& stack)
    : RowTerm(std::move(data), std::move(root), all_dofs(mujoco.nv), mujoco, stack) {}

void ForeignRows::read() {
  const int count = static_cast<int>(dofs_.size());
  for (int r = 0; r < data_.rows; ++r) {
    const double* given = stack_.jacobian + (data_.first + r) * mujoco_.nv;
    double* own = jacobian_.data() + r * stride_;
    for (int k = 0; k < count; ++k) own[k] = given[dofs_[k]];
  }
  weigh();
}

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
