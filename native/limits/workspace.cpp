#include "limits/workspace.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/lie.hpp"

namespace rmrc {

namespace {

const double* position_of(const Kinematics& at, const Plane& plane) {
  switch (plane.anchor) {
    case Anchor::site:
      return at.site_xpos + 3 * plane.id;
    case Anchor::geom:
      return at.geom_xpos + 3 * plane.id;
    case Anchor::body:
      return at.xpos + 3 * plane.id;
  }
  return nullptr;
}

// Write the axis of a rotation, and return its angle in [0, π].
double rotation(const double* quaternion, double* axis) {
  const double side = quaternion[0] < 0.0 ? -1.0 : 1.0;
  const double sine = std::sqrt(dot3(quaternion + 1, quaternion + 1));
  for (int i = 0; i < 3; ++i) {
    axis[i] = sine > 0.0 ? side * quaternion[1 + i] / sine : (i == 0 ? 1.0 : 0.0);
  }
  return 2.0 * std::atan2(sine, std::abs(quaternion[0]));
}

}  // namespace

Workspace::Workspace(std::vector<Plane> planes, double gain, double push, const double* twist,
                     int nv)
    : Barrier(static_cast<int>(planes.size()), gain, push),
      planes_(std::move(planes)),
      twist_(twist),
      nv_(nv) {}

void Workspace::read(const Kinematics& at, bool, Poses& poses) const {
  for (const Plane& plane : planes_) {
    poses.push_back(position_of(at, plane));
    poses.push_back(at.reference + 3 * plane.root);
  }
}

void Workspace::near(const Kinematics& now, const double*, double, Near& near) {
  near.count = size();
  for (int k = 0; k < size(); ++k) {
    const Plane& plane = planes_[k];
    const double *normal = plane.normal, *position = position_of(now, plane);
    double *slope = near.slope + static_cast<long>(k) * nv_, arm[3], moment[3];
    for (int i = 0; i < 3; ++i) arm[i] = position[i] - now.reference[3 * plane.root + i];
    cross(arm, normal, moment);
    std::fill_n(slope, nv_, 0.0);
    for (const int dof : plane.dofs) {
      const double* axis = now.cdof + 6 * dof;
      slope[dof] = dot3(moment, axis) + dot3(normal, axis + 3);
    }
    near.ids[k] = k;
    near.distance[k] = dot3(normal, position) - plane.offset;
    near.drift[k] = 0.0;
    if (plane.mocap < 0) continue;
    const double* twist = twist_ + 6 * plane.mocap;
    for (int i = 0; i < 3; ++i) arm[i] = position[i] - now.mocap_pos[3 * plane.mocap + i];
    cross(arm, normal, moment);
    near.drift[k] = dot3(normal, twist) + dot3(moment, twist + 3);
  }
}

double Workspace::distance(const Kinematics& at, int id) const {
  return dot3(planes_[id].normal, position_of(at, planes_[id])) - planes_[id].offset;
}

double Workspace::reach(int id, const double* step, double dt) const {
  const std::vector<double>& levers = planes_[id].levers;
  double sum = 0.0;
  for (int i = 0; i < nv_; ++i) sum += levers[i] * std::abs(step[i]);
  for (int i = nv_; i < static_cast<int>(levers.size()); ++i) {
    sum += levers[i] * std::abs(twist_[i - nv_]) * dt;
  }
  return sum;
}

BallRange::BallRange(std::vector<Ball> balls, double gain, double push, int nv)
    : Barrier(static_cast<int>(balls.size()), gain, push), balls_(std::move(balls)), nv_(nv) {}

// Of q alone.
void BallRange::read(const Kinematics&, bool, Poses&) const {}

void BallRange::near(const Kinematics& now, const double*, double, Near& near) {
  near.count = size();
  for (int k = 0; k < size(); ++k) {
    double *slope = near.slope + static_cast<long>(k) * nv_, axis[3];
    const double angle = rotation(now.qpos + balls_[k].coordinate, axis);
    std::fill_n(slope, nv_, 0.0);
    for (int i = 0; i < 3; ++i) slope[balls_[k].dof + i] = -axis[i];
    near.ids[k] = k;
    near.distance[k] = balls_[k].largest - angle;
    near.drift[k] = 0.0;
  }
}

double BallRange::distance(const Kinematics& at, int id) const {
  double axis[3];
  return balls_[id].largest - rotation(at.qpos + balls_[id].coordinate, axis);
}

// No rotation adds more than its own angle to another.
double BallRange::reach(int id, const double* step, double) const {
  const double* turn = step + balls_[id].dof;
  return norm3(turn);
}

TendonRange::TendonRange(std::vector<TendonEnd> ends, double gain, double push, int nv)
    : Barrier(static_cast<int>(ends.size()), gain, push), ends_(std::move(ends)), nv_(nv) {}

// Of q alone.
void TendonRange::read(const Kinematics&, bool, Poses&) const {}

void TendonRange::near(const Kinematics& now, const double*, double, Near& near) {
  near.count = size();
  for (int k = 0; k < size(); ++k) {
    const TendonEnd& end = ends_[k];
    double* slope = near.slope + static_cast<long>(k) * nv_;
    std::fill_n(slope, nv_, 0.0);
    for (std::size_t j = 0; j < end.dofs.size(); ++j) {
      slope[end.dofs[j]] = end.sign * end.coefficients[j];
    }
    near.ids[k] = k;
    near.distance[k] = distance(now, k);
    near.drift[k] = 0.0;
  }
}

double TendonRange::distance(const Kinematics& at, int id) const {
  const TendonEnd& end = ends_[id];
  double length = 0.0;
  for (std::size_t j = 0; j < end.coordinates.size(); ++j) {
    length += end.coefficients[j] * at.qpos[end.coordinates[j]];
  }
  return end.sign * (length - end.bound);
}

double TendonRange::reach(int id, const double* step, double) const {
  const TendonEnd& end = ends_[id];
  double sum = 0.0;
  for (std::size_t j = 0; j < end.dofs.size(); ++j) {
    sum += std::abs(end.coefficients[j] * step[end.dofs[j]]);
  }
  return sum;
}

}  // namespace rmrc
