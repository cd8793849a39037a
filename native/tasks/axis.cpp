#include "tasks/axis.hpp"

#include <algorithm>
#include <utility>

#include "base/lie.hpp"
#include "tasks/pointing.hpp"

namespace rmrc {

namespace {

constexpr double least_length = 1e-10;  // a target nearer than this, m, has no direction
constexpr double least_angle = 1e-9;    // rad

}  // namespace

Axis::Axis(TermData data, std::vector<double> root, Frame frame, const double* axis, bool at_point,
           const MuJoCo& mujoco, const Stack& stack)
    : RowTerm(std::move(data), std::move(root), Reads().add(frame), mujoco, stack),
      frame_(std::move(frame)),
      at_point_(at_point) {
  std::copy_n(axis, 3, axis_);
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

}  // namespace rmrc
