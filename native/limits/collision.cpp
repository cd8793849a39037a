#include "limits/collision.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/kernels.hpp"
#include "base/lie.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

constexpr double farthest = 1e10;  // rmrc.limits.collision.FARTHEST

}  // namespace

Collision::Collision(const PairArrays& arrays, const MuJoCo& mujoco)
    : Barrier(arrays.pairs, arrays.gain, arrays.push),
      a_(arrays),
      home_(arrays),
      mujoco_(mujoco),
      nv_(mujoco.nv),
      width_(mujoco.nv + 6 * arrays.mocaps),
      travel_(width_),
      moved_(arrays.bodies),
      origin_(3 * static_cast<std::size_t>(mujoco.nv)) {}

// Do something for the number of each active pair, in ascending order; few of many are.
template <class Action>
void Collision::each_active(Action action) const {
  int id = 0;
  for (; id + 8 <= a_.pairs; id += 8) {
    std::uint64_t eight;
    std::memcpy(&eight, a_.active + id, sizeof eight);
    if (eight == 0) continue;
    for (int k = id; k < id + 8; ++k) {
      if (a_.active[k]) action(k);
    }
  }
  for (; id < a_.pairs; ++id) {
    if (a_.active[id]) action(id);
  }
}

void Collision::read(const Kinematics& at, bool ahead, Poses& poses) const {
  for (int k = 0; k < 2 * a_.pairs; ++k) {
    poses.push_back(at.geom_xpos + 3 * a_.geoms[k]);
    poses.push_back(at.geom_xmat + 9 * a_.geoms[k]);
    poses.push_back(at.reference + 3 * a_.root[k]);
  }
  for (int body = 0; !ahead && body < a_.bodies; ++body) {  // it adds up how far they have moved
    poses.push_back(at.xpos + 3 * body);
    poses.push_back(at.xquat + 4 * body);
  }
}

void Collision::near(const Kinematics& now, const double* travel, double dt, Near& near) {
  double motion = bound(now);
  extend(travel, dt);
  const double more = grown();
  if (!(motion + more < *a_.room) && !(2.0 * most_moved() + more < *a_.room)) {
    activate(now);
    motion = 0.0;
  }
  look(now);
  release(now, motion);
  for (int dof = 0; dof < nv_; ++dof) {
    const double* axis = now.cdof + 6 * dof;
    double turned[3];
    cross(axis, now.reference + 3 * a_.dof_root[dof], turned);
    for (int i = 0; i < 3; ++i) origin_[3 * dof + i] = axis[3 + i] - turned[i];
  }
  near.count = 0;
  each_active([&](int id) {
    direct(now, id);
    write(now, id, a_.segments + 6 * id, a_.normals + 3 * id, a_.distance[id], near);
    if (a_.distance[id] > a_.precision[0]) see_contact(now, id);
  });
}

// Write a pair at a segment between its geoms.
void Collision::write(const Kinematics& now, int id, const double* segment, const double* normal,
                      double distance, Near& near) const {
  const int k = near.count++;
  near.ids[k] = id;
  near.distance[k] = distance - a_.d_min;
  near.drift[k] = drift(now, id, segment, normal);
  differentiate(now, id, segment, normal, near.slope + static_cast<long>(k) * nv_);
}

void Collision::kept(const Kinematics& now, Near& near) {
  near.count = 0;
  each_active([&](int id) {
    if (a_.distance[id] > a_.precision[0]) write_contacts(now, id, near);
  });
}

void Collision::keep(Memory& memory) {
  const auto place = [&](auto* PairArrays::*array, int count) {
    memory.place(a_.*array, home_.*array, count);
  };
  for (const auto array : {&PairArrays::bound, &PairArrays::threshold, &PairArrays::distance}) {
    place(array, a_.pairs);
  }
  place(&PairArrays::segments, 6 * a_.pairs);
  place(&PairArrays::normals, 3 * a_.pairs);
  place(&PairArrays::room, 1);
  place(&PairArrays::travel, width_);
  for (const auto array : {&PairArrays::position, &PairArrays::seen_position}) {
    place(array, 3 * a_.bodies);
  }
  for (const auto array : {&PairArrays::quaternion, &PairArrays::seen_quaternion}) {
    place(array, 4 * a_.bodies);
  }
  place(&PairArrays::contacts, contacts_of_pair * a_.pairs);
  place(&PairArrays::contact_count, a_.pairs);
  place(&PairArrays::active, a_.pairs);
  place(&PairArrays::measured, a_.pairs);
}

// Return how much nearer two geoms can have come to each other since the poses of reference.
double Collision::bound(const Kinematics& now) {
  double shift = 0.0, turn = 0.0;
  for (int b = 0; b < a_.bodies; ++b) {
    double shifted = 0.0, turned = 0.0;
    for (int i = 3 * b; i < 3 * b + 3; ++i) {
      const double change = now.xpos[i] - a_.position[i];
      shifted += change * change;
    }
    for (int i = 4 * b; i < 4 * b + 4; ++i) {
      const double change = a_.reach[b] * (now.xquat[i] - a_.quaternion[i]);
      turned += change * change;
    }
    moved_[b] = std::sqrt(shifted) + std::sqrt(turned);
    shift += shifted;
    turn += turned;
  }
  // The sum of two of the bodies' motions is at most √2 times the norm of all.
  return 1.4143 * (std::sqrt(shift) + std::sqrt(turn));
}

double Collision::most_moved() { return *std::max_element(moved_.begin(), moved_.end()); }

// Join the travel of the dofs with that of the mocap bodies.
void Collision::extend(const double* travel, double dt) {
  for (int i = 0; i < nv_; ++i) travel_[i] = std::fmin(travel[i], farthest);
  for (int i = nv_; i < width_; ++i) travel_[i] = std::abs(a_.twist[i - nv_]) * dt;
}

double Collision::grown() const {
  double sum = 0.0;
  for (int i = 0; i < width_; ++i) {
    sum += std::fmax(travel_[i] - a_.travel[i], 0.0) * a_.longest[i];
  }
  return sum;
}

// Return the distance below which a pair becomes active, with the travel of now.
double Collision::threshold(int id) const {
  const double near = dot(a_.levers + static_cast<long>(id) * width_, travel_.data(), width_) + a_.d_min;
  return std::min(std::max(near, a_.detect), 0.5 * farthest);
}

// Make the poses of now those of reference, and find the pairs that are near there.
void Collision::activate(const Kinematics& now) {
  const bool changed = !std::equal(travel_.begin(), travel_.end(), a_.travel);
  std::copy(travel_.begin(), travel_.end(), a_.travel);
  std::copy_n(now.xpos, 3 * a_.bodies, a_.position);
  std::copy_n(now.xquat, 4 * a_.bodies, a_.quaternion);
  look(now);
  double room = infinity;
  for (int id = 0; id < a_.pairs; ++id) {
    a_.bound[id] -= moved_[a_.body[2 * id]] + moved_[a_.body[2 * id + 1]];
    if (changed) a_.threshold[id] = threshold(id);
    const double level = a_.threshold[id];
    if (!(a_.bound[id] > level) && !is_far(now, id, level)) {
      a_.bound[id] = measure(now, id);
      if (!(a_.bound[id] > level)) {
        a_.active[id] = 1;
        a_.bound[id] = infinity;
      }
    }
    room = std::min(room, a_.bound[id] - level);
  }
  *a_.room = room;
}

// Raise the bound to that of the bounding spheres, if it is far above a level.
bool Collision::is_far(const Kinematics& now, int id, double level) {
  const std::int64_t first = a_.geoms[2 * id], second = a_.geoms[2 * id + 1];
  double apart[3];
  for (int i = 0; i < 3; ++i) apart[i] = now.geom_xpos[3 * second + i] - now.geom_xpos[3 * first + i];
  double distance = -a_.radii[id];
  if (a_.plane[id]) {
    const double* turn = now.geom_xmat + 9 * first;
    distance += apart[0] * turn[2] + apart[1] * turn[5] + apart[2] * turn[8];
  } else {
    distance += norm3(apart);
  }
  if (!(distance > level + a_.detect)) return false;
  a_.bound[id] = distance;
  return true;
}

double Collision::measure(const Kinematics& now, int id) {
  if (!a_.measured[id]) {
    a_.distance[id] = signed_distance(mujoco_, now, pair(id), farthest, a_.segments + 6 * id);
    a_.measured[id] = 1;
  }
  return a_.distance[id];
}

// Forget what was measured at other poses.
void Collision::look(const Kinematics& now) {
  if (std::equal(now.xpos, now.xpos + 3 * a_.bodies, a_.seen_position) &&
      std::equal(now.xquat, now.xquat + 4 * a_.bodies, a_.seen_quaternion)) {
    return;
  }
  std::copy_n(now.xpos, 3 * a_.bodies, a_.seen_position);
  std::copy_n(now.xquat, 4 * a_.bodies, a_.seen_quaternion);
  std::fill_n(a_.measured, a_.pairs, std::uint8_t{0});
}

// Let go of the active pairs that are far enough.
void Collision::release(const Kinematics& now, double motion) {
  each_active([&](int id) {
    if (!(measure(now, id) > leave * threshold(id))) return;
    a_.active[id] = 0;
    // Known at the poses of now, and at those of reference less by the way between.
    a_.bound[id] = a_.distance[id] - motion;
    *a_.room = std::min(*a_.room, a_.bound[id] - a_.threshold[id]);
  });
}

// Write the normal of a pair. Geoms that touch, or whose axes cross, have none: they keep the last
// one known, else that of the plane or of their centres.
void Collision::direct(const Kinematics& now, int id) {
  const double* segment = a_.segments + 6 * id;
  double *kept = a_.normals + 3 * id, normal[3];
  for (int i = 0; i < 3; ++i) normal[i] = segment[3 + i] - segment[i];
  double length = norm3(normal);
  if (length > a_.precision[0]) {
    length = std::copysign(length, a_.distance[id]);
  } else {
    const std::int64_t first = a_.geoms[2 * id], second = a_.geoms[2 * id + 1];
    const bool known = kept[0] != 0.0 || kept[1] != 0.0 || kept[2] != 0.0;
    for (int i = 0; i < 3; ++i) {
      normal[i] = known           ? kept[i]
                  : a_.plane[id] ? now.geom_xmat[9 * first + 3 * i + 2]
                                 : now.geom_xpos[3 * second + i] - now.geom_xpos[3 * first + i];
    }
    length = norm3(normal);
    if (length == 0.0) length = 1.0;
  }
  for (int i = 0; i < 3; ++i) kept[i] = normal[i] / length;
}

// Write nᵀ(J_b − J_a) (nv,): the nearest points are on one line along n, so that the moment of n
// about the world's origin is the same at both.
void Collision::differentiate(const Kinematics& now, int id, const double* segment,
                              const double* normal, double* slope) const {
  const double* side = a_.side + static_cast<long>(id) * nv_;
  double moment[3];
  cross(segment, normal, moment);
  for (int dof = 0; dof < nv_; ++dof) {
    const double along = dot3(normal, origin_.data() + 3 * dof) + dot3(moment, now.cdof + 6 * dof);
    slope[dof] = side[dof] == 0.0 ? 0.0 : side[dof] * along;
  }
}

// Return nᵀ(v_b − v_a) of the mocap bodies.
double Collision::drift(const Kinematics& now, int id, const double* segment,
                        const double* normal) const {
  double drift = 0.0;
  if (a_.mocaps == 0) return drift;
  for (int side = 0; side < 2; ++side) {
    const std::int64_t mocap = a_.mocap[2 * id + side];
    if (mocap < 0) continue;
    const double* twist = a_.twist + 6 * mocap;
    const double* origin = now.xpos + 3 * a_.root[2 * id + side];
    double arm[3], moment[3];
    for (int i = 0; i < 3; ++i) arm[i] = segment[3 * side + i] - origin[i];
    cross(arm, normal, moment);
    const double speed = dot3(normal, twist) + dot3(moment, twist + 3);
    drift += side == 1 ? speed : -speed;
  }
  return drift;
}

double Collision::distance(const Kinematics& at, int id) const {
  double segment[6];
  return signed_distance(mujoco_, at, pair(id), farthest, segment) - a_.d_min;
}

double Collision::reach(int id, const double* step, double dt) const {
  const double* levers = a_.levers + static_cast<long>(id) * width_;
  double sum = 0.0;
  for (int i = 0; i < nv_; ++i) sum += levers[i] * std::fmin(std::abs(step[i]), farthest);
  for (int i = nv_; i < width_; ++i) sum += levers[i] * (std::abs(a_.twist[i - nv_]) * dt);
  return sum;
}

PairPlane Collision::plane(const Kinematics& now, int id) const {
  const double blurred = a_.precision[1];
  const double known = a_.distance[id] > blurred ? a_.distance[id] - blurred - a_.d_min : -infinity;
  const std::int64_t base = a_.base[id], other = a_.other[id];
  PairPlane plane{known, known, {}, {}};
  double away[3];
  for (int i = 0; i < 3; ++i) away[i] = a_.sign[id] * a_.normals[3 * id + i];
  rotate_back(now.geom_xmat + 9 * base, away, plane.normal);
  rotate_back(now.geom_xmat + 9 * other, away, plane.seen);
  for (int i = 0; i < 3; ++i) {
    plane.offset -= away[i] * (now.geom_xpos[3 * other + i] - now.geom_xpos[3 * base + i]);
  }
  return plane;
}

double Collision::least(const Kinematics& at, int id, const PairPlane& plane) const {
  const std::int64_t base = a_.base[id], other = a_.other[id];
  double away[3], turned[3], gap = 0.0;
  rotate(at.geom_xmat + 9 * base, plane.normal, away);
  rotate_back(at.geom_xmat + 9 * other, away, turned);
  for (int i = 0; i < 3; ++i) {
    turned[i] -= plane.seen[i];
    gap += away[i] * (at.geom_xpos[3 * other + i] - at.geom_xpos[3 * base + i]);
  }
  return plane.offset + gap - a_.spread[id] * norm3(turned);
}

double Collision::fall(int id, const double* step) const {
  return dot(a_.levers + static_cast<long>(id) * width_, step, nv_);
}

double Collision::bend(int id, double reach, const double* speed, const double* change) const {
  const double* levers = a_.levers + static_cast<long>(id) * width_;
  const double *carries = a_.carries + static_cast<long>(id) * nv_,
               *moves = a_.moves + static_cast<long>(id) * nv_;
  const double across = a_.distance[id] + reach + a_.width[id];
  double carried_change = 0.0, carried_speed = 0.0, moved_speed = 0.0;
  for (int i = 0; i < nv_; ++i) {
    const double carried = levers[i] + (carries[i] == 0.0 ? 0.0 : carries[i] * across);
    carried_change += carried * change[i];
    carried_speed += carried * speed[i];
    moved_speed += moves[i] * speed[i];
  }
  return carried_change + carried_speed * moved_speed;
}

GeomPair Collision::pair(int id) const {
  const std::int64_t first = a_.geoms[2 * id], second = a_.geoms[2 * id + 1];
  const double *capsule = a_.size + 3 * first, *box = a_.size + 3 * second;
  return {static_cast<int>(first), static_cast<int>(second), a_.doubtful[id] != 0,
          {box[0], box[1], box[2]}, capsule[0], capsule[1]};
}

}  // namespace rmrc
