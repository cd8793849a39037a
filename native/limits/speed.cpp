#include "limits/speed.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"
#include "base/lie.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.limits.speed: INSIDE and STILL.
constexpr double inside = 1e-4;
constexpr double no_direction = 1e-12;

}  // namespace

double SpeedBall::velocity(const double* v, double* moved) const {
  for (int i = 0; i < 3; ++i) moved[i] = dot(jacobian_.data() + i * n_, v, n_);
  return norm3(moved);
}

// Have the planes of these directions, and no others.
void SpeedBall::begin(const double (&directions)[2][3], double* rows, double* upper) {
  std::fill_n(rows, planes * n_, 0.0);
  std::fill_n(upper, planes, infinity);
  used_ = 0;
  curvature_ = 0.0;
  bent_ = false;
  for (const auto& direction : directions) add(direction, rows, upper);
}

bool SpeedBall::cut(const double* v, const double* y, double* rows, double* upper) {
  double moved[3], multiplier = 0.0;
  const double length = velocity(v, moved);
  for (int k = 0; y != nullptr && k < planes; ++k) multiplier += y[k];
  const bool unbent = multiplier > 0.0 && !bent_;
  if (length <= largest_ && !unbent) {
    const bool idle = curvature_ > 0.0 && !(multiplier > 0.0);
    if (idle) curvature_ = 0.0;  // no ball is in the way, and so no curvature of it
    return idle;
  }
  curvature_ = std::max(multiplier, 0.0) / ((1.0 - inside) * largest_);
  if (unbent) {
    bent_ = true;
    std::copy_n(directions_[std::max_element(y, y + planes) - y], 3, direction_);
    return true;
  }
  return add(moved, rows, upper);
}

bool SpeedBall::add(const double* direction, double* rows, double* upper) {
  const double length = norm3(direction);
  if (!(length > no_direction) || used_ == planes) return false;
  for (int i = 0; i < 3; ++i) directions_[used_][i] = direction_[i] = direction[i] / length;
  double* row = rows + static_cast<long>(used_) * n_;
  for (int i = 0; i < 3; ++i) {
    const double* jacobian = jacobian_.data() + i * n_;
    for (int k = 0; k < n_; ++k) row[k] += direction_[i] * jacobian[k];
  }
  upper[used_++] = (1.0 - inside) * largest_;
  return true;
}

void SpeedBall::bend(double* H) const {
  const double *x = jacobian_.data(), *y = x + n_, *z = y + n_;
  for (int a = 0; a < n_; ++a) {
    const double column[3] = {x[a], y[a], z[a]}, along = dot3(direction_, column);
    double across[3];
    for (int i = 0; i < 3; ++i) across[i] = curvature_ * (column[i] - along * direction_[i]);
    double* row = H + static_cast<long>(a) * n_;
    for (int b = 0; b < n_; ++b) row[b] += across[0] * x[b] + across[1] * y[b] + across[2] * z[b];
  }
}

SpeedRows::SpeedRows(Frame frame, bool turned, double linear, double angular, const double* rate,
                     const double* v_previous, const int* place, int n, const double* cdof)
    : frame_(std::move(frame)),
      turned_(turned),
      rate_(rate),
      v_previous_(v_previous),
      place_(place),
      n_(n),
      cdof_(cdof) {
  const double largest[2] = {linear, angular};
  for (int half = 0; half < 2; ++half) {
    if (largest[half] == infinity) continue;
    at_.push_back(3 * half);
    balls_.emplace_back(largest[half], n);
  }
}

void SpeedRows::write(double* rows, double* upper) {
  double arm[3];
  for (int i = 0; i < 3; ++i) arm[i] = frame_.position[i] - frame_.reference[i];
  for (std::size_t half = 0; half < balls_.size(); ++half) {
    SpeedBall& ball = balls_[half];
    double directions[2][3]{};
    for (const int dof : frame_.dofs) {
      const double* axis = cdof_ + 6 * dof;
      double moved[3] = {axis[0], axis[1], axis[2]};
      if (at_[half] == 0) {
        cross(axis, arm, moved);
        for (int i = 0; i < 3; ++i) moved[i] += axis[3 + i];
      }
      for (int i = 0; i < 3; ++i) {
        directions[0][i] += moved[i] * v_previous_[dof];
        if (place_[dof] >= 0) ball.jacobian()[i * n_ + place_[dof]] = moved[i];
      }
    }
    const double* asked = rate_ + at_[half];
    if (turned_) {
      rotate(frame_.rotation, asked, directions[1]);
    } else {
      std::copy_n(asked, 3, directions[1]);
    }
    ball.begin(directions, rows + static_cast<long>(planes * half) * n_, upper + planes * half);
  }
}

bool SpeedRows::cut(const double* v, const double* y, double* rows, double* upper) {
  bool changed = false;
  for (std::size_t half = 0; half < balls_.size(); ++half) {
    const long first = static_cast<long>(planes * half);
    changed |= balls_[half].cut(v, y == nullptr ? nullptr : y + first, rows + first * n_,
                                upper + first);
  }
  return changed;
}

void SpeedRows::bend(double* H) const {
  for (const SpeedBall& ball : balls_) {
    if (ball.curvature() > 0.0) ball.bend(H);
  }
}

double SpeedRows::excess(const double* v) const {
  double worst = -infinity, moved[3];
  for (const SpeedBall& ball : balls_) {
    worst = std::max(worst, ball.velocity(v, moved) - ball.largest());
  }
  return worst;
}

double SpeedRows::share(const double* brake, const double* v) const {
  double most = 1.0;
  for (const SpeedBall& ball : balls_) {
    double start[3], way[3];
    ball.velocity(brake, start);
    ball.velocity(v, way);
    for (int i = 0; i < 3; ++i) way[i] -= start[i];
    // ‖start + s way‖² = V²
    const double room = ball.largest() * ball.largest() - dot3(start, start);
    if (room <= 0.0) return 0.0;
    const double square = dot3(way, way), along = dot3(start, way);
    if (!(square > 0.0)) continue;
    const double root = std::sqrt(along * along + square * room);
    if (along + root > 0.0) most = std::min(most, room / (along + root));
  }
  return most;
}

}  // namespace rmrc
