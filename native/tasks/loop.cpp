#include "tasks/loop.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"
#include "base/lie.hpp"

namespace rmrc {

namespace {

Reads reads_of(const std::vector<BodyPair>& pairs, const std::vector<Polynomial>& polynomials) {
  Reads reads;
  for (const BodyPair& pair : pairs) {
    for (const Anchorage& end : pair.ends) reads.add(end.frame).add(end.quaternion);
  }
  for (const Polynomial& polynomial : polynomials) {
    for (const Combination* side : {&polynomial.y, &polynomial.x}) {
      for (const Combination::Part& part : side->parts) reads.add(part.dof);
    }
  }
  return reads;
}

bool contains(const std::vector<int>& dofs, int dof) {
  return std::find(dofs.begin(), dofs.end(), dof) != dofs.end();
}

// out = a b.
void product(const double* a, const double* b, double* out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

double value_of(const Combination& combination, const double* q) {
  double sum = -combination.reference;
  for (const Combination::Part& part : combination.parts) {
    sum += part.coefficient * q[part.coordinate];
  }
  return sum;
}

}  // namespace

Loop::Loop(TermData data, std::vector<double> root, std::vector<BodyPair> pairs,
           std::vector<Polynomial> polynomials, std::vector<double> scale,
           std::vector<char> angular, const MuJoCo& mujoco, const Stack& stack)
    : RowTerm(std::move(data), std::move(root), reads_of(pairs, polynomials), mujoco, stack),
      pairs_(std::move(pairs)),
      polynomials_(std::move(polynomials)),
      scale_(std::move(scale)),
      angular_(std::move(angular)),
      column_(mujoco.nv) {
  for (std::size_t k = 0; k < dofs_.size(); ++k) column_[dofs_[k]] = static_cast<int>(k);
  for (const BodyPair& pair : pairs_) {
    for (const int dof : dofs_) {
      const bool first = contains(pair.ends[0].frame.dofs, dof);
      const bool second = contains(pair.ends[1].frame.dofs, dof);
      carries_.push_back(static_cast<char>((first ? 1 : 0) + (second ? 2 : 0)));
    }
  }
}

void Loop::measure(double* measures) const {
  double squares[2] = {0.0, 0.0};
  for (int r = 0; r < data_.rows; ++r) {
    const double value = scale_[r] * error()[r];
    squares[angular_[r] ? 1 : 0] += value * value;
  }
  for (int k = 0; k < 2; ++k) measures[k] = std::sqrt(squares[k]);
}

void Loop::differentiate() {
  std::fill(jacobian_.begin(), jacobian_.end(), 0.0);
  const char* carries = carries_.data();
  for (const BodyPair& pair : pairs_) {
    differentiate(pair, carries);
    carries += dofs_.size();
  }
  for (const Polynomial& polynomial : polynomials_) differentiate(polynomial);
}

void Loop::differentiate(const BodyPair& pair, const char* carries) {
  double* e = error() + pair.first;
  double* rows = jacobian_.data() + pair.first * stride_;
  double place[2][3], offset[2][3], turned[2][4], gap[4];
  for (int k = 0; k < 2; ++k) {
    const Anchorage& end = pair.ends[k];
    rotate(end.frame.rotation, end.point, place[k]);
    for (int i = 0; i < 3; ++i) {
      place[k][i] += end.frame.position[i];
      offset[k][i] = place[k][i] - end.frame.reference[i];
    }
  }
  if (pair.welded) {
    for (int k = 0; k < 2; ++k) product(pair.ends[k].quaternion, pair.ends[k].turn, turned[k]);
    conjugate_multiply(turned[1], turned[0], gap);
  }
  // The rate of q₂* q₁ is ½ q₂* (ω₁ − ω₂) q₁, for angular velocities in the form [0; ω].
  const auto rate_of_turn = [&](const double* angular, double* out) {
    double half[4], rate[4];
    conjugate_multiply(turned[1], angular, half);
    product(half, turned[0], rate);
    for (int i = 0; i < 3; ++i) out[i] = 0.5 * pair.torque_scale * rate[1 + i];
  };
  bool moved = false;
  for (std::size_t column = 0; column < dofs_.size(); ++column) {
    if (carries[column] == 0) continue;
    moved = true;
    const double* axis = mujoco_.cdof + 6 * dofs_[column];
    double linear[3] = {}, angular[4] = {};
    for (int k = 0; k < 2; ++k) {
      if ((carries[column] & (k + 1)) == 0) continue;
      const double sign = k == 0 ? 1.0 : -1.0;
      double lever[3];
      cross(axis, offset[k], lever);
      for (int i = 0; i < 3; ++i) {
        linear[i] += sign * (axis[3 + i] + lever[i]);
        angular[1 + i] += sign * axis[i];
      }
    }
    for (int i = 0; i < 3; ++i) rows[i * stride_ + column] = linear[i];
    if (!pair.welded) continue;
    double rate[3];
    rate_of_turn(angular, rate);
    for (int i = 0; i < 3; ++i) rows[(3 + i) * stride_ + column] = rate[i];
  }
  for (int k = 0; k < 2; ++k) {
    const Frame& frame = pair.ends[k].frame;
    if (frame.carrier == nullptr || !moved) continue;
    const double sign = k == 0 ? 1.0 : -1.0;
    double* drift = drift_.data() + pair.first;
    double velocity[3];
    velocity_at(frame.carrier, frame.reference, place[k], velocity);
    for (int i = 0; i < 3; ++i) drift[i] += sign * velocity[i];
    if (!pair.welded) continue;
    double angular[4] = {}, rate[3];
    std::copy_n(frame.carrier + 3, 3, angular + 1);
    rate_of_turn(angular, rate);
    for (int i = 0; i < 3; ++i) drift[3 + i] += sign * rate[i];
  }
  for (int i = 0; i < 3; ++i) e[i] = moved ? place[1][i] - place[0][i] : 0.0;
  if (!pair.welded) return;
  for (int i = 0; i < 3; ++i) e[3 + i] = moved ? -pair.torque_scale * gap[1 + i] : 0.0;
}

void Loop::differentiate(const Polynomial& polynomial) {
  const double x = value_of(polynomial.x, mujoco_.qpos);
  double value = 0.0, slope = 0.0;
  for (int k = 4; k >= 0; --k) {
    slope = slope * x + value;
    value = value * x + polynomial.coefficients[k];
  }
  error()[polynomial.first] = value - value_of(polynomial.y, mujoco_.qpos);
  double* row = jacobian_.data() + polynomial.first * stride_;
  for (const Combination::Part& part : polynomial.y.parts) {
    row[column_[part.dof]] += part.coefficient;
  }
  for (const Combination::Part& part : polynomial.x.parts) {
    row[column_[part.dof]] -= slope * part.coefficient;
  }
}

}  // namespace rmrc
