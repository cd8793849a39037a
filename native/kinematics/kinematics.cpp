#include "kinematics/kinematics.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <utility>

#include "base/lie.hpp"

// MuJoCo adds in this order, and this file is compiled without fused products: distances of meshes
// jump with the last bit of a pose, so that nearly the same would not do.
namespace rmrc {

namespace {

constexpr double least = 1e-15;  // mjMINVAL

void multiply(const double* a, const double* b, double* out) {
  const double made[4] = {(a[0] * b[0] - a[1] * b[1]) - (a[2] * b[2] + a[3] * b[3]),
                          (a[0] * b[1] + a[1] * b[0]) + (a[2] * b[3] - a[3] * b[2]),
                          (a[0] * b[2] - a[1] * b[3]) + (a[2] * b[0] + a[3] * b[1]),
                          (a[0] * b[3] + a[1] * b[2]) - (a[2] * b[1] - a[3] * b[0])};
  std::copy_n(made, 4, out);
}

void normalize(double* q) {
  const double norm = std::sqrt((q[0] * q[0] + q[1] * q[1]) + (q[2] * q[2] + q[3] * q[3]));
  if (norm < least) {
    q[0] = 1.0;
    q[1] = q[2] = q[3] = 0.0;
  } else if (std::abs(norm - 1.0) > least) {
    const double scale = 1.0 / norm;
    for (int i = 0; i < 4; ++i) q[i] *= scale;
  }
}

bool is_unit(const double* q) { return q[0] == 1.0 && q[1] == 0.0 && q[2] == 0.0 && q[3] == 0.0; }

bool is_zero(const double* v) { return v[0] == 0.0 && v[1] == 0.0 && v[2] == 0.0; }

void turn(const double* v, const double* q, double* out) {
  if (is_zero(v) || is_unit(q)) {
    std::copy_n(v, 3, out);
    return;
  }
  const double half[3] = {q[0] * v[0] + q[2] * v[2] - q[3] * v[1],
                          q[0] * v[1] + q[3] * v[0] - q[1] * v[2],
                          q[0] * v[2] + q[1] * v[1] - q[2] * v[0]};
  out[0] = v[0] + 2.0 * (q[2] * half[2] - q[3] * half[1]);
  out[1] = v[1] + 2.0 * (q[3] * half[0] - q[1] * half[2]);
  out[2] = v[2] + 2.0 * (q[1] * half[1] - q[2] * half[0]);
}

void write_matrix(const double* q, double* out) {
  const double ww = q[0] * q[0], wx = q[0] * q[1], wy = q[0] * q[2], wz = q[0] * q[3];
  const double xx = q[1] * q[1], xy = q[1] * q[2], xz = q[1] * q[3];
  const double yy = q[2] * q[2], yz = q[2] * q[3], zz = q[3] * q[3];
  out[0] = (ww - yy) + (xx - zz);
  out[1] = 2.0 * (xy - wz);
  out[2] = 2.0 * (xz + wy);
  out[3] = 2.0 * (xy + wz);
  out[4] = (ww + yy) - (xx + zz);
  out[5] = 2.0 * (yz - wx);
  out[6] = 2.0 * (xz - wy);
  out[7] = 2.0 * (yz + wx);
  out[8] = (ww - yy) - (xx - zz);
}

// q ← q turned about one of its own axes, by the cosine and the sine of half the angle: the product
// without its zeros.
void turn_about(int along, double cosine, double sine, double* q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  switch (along) {
    case 0:
      q[0] = w * cosine - x * sine;
      q[1] = w * sine + x * cosine;
      q[2] = y * cosine + z * sine;
      q[3] = z * cosine - y * sine;
      break;
    case 1:
      q[0] = w * cosine - y * sine;
      q[1] = x * cosine - z * sine;
      q[2] = w * sine + y * cosine;
      q[3] = x * sine + z * cosine;
      break;
    default:
      q[0] = w * cosine - z * sine;
      q[1] = x * cosine + y * sine;
      q[2] = y * cosine - x * sine;
      q[3] = w * sine + z * cosine;
      break;
  }
}

// The one of the three axes that a vector is along, or −1.
int one_of_three(const double* v) {
  for (int k = 0; k < 3; ++k) {
    if (std::abs(v[k]) == 1.0 && v[(k + 1) % 3] == 0.0 && v[(k + 2) % 3] == 0.0) return k;
  }
  return -1;
}

// out = R v + p
void carry(const double* R, const double* v, const double* p, double* out) {
  for (int i = 0; i < 3; ++i) {
    out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2] + p[i];
  }
}

}  // namespace

ForwardKinematics::ForwardKinematics(Placed placed, const PoseArrays& arrays, int nq)
    : placed_(std::move(placed)), a_(arrays), nq_(nq) {
  std::size_t most = 0;
  for (Body& body : placed_.bodies) {
    body.free = body.joints.size() == 1 && body.joints[0].kind == JointKind::free;
    body.shifted = body.mocap >= 0 || !is_zero(body.position);
    body.turned = body.mocap >= 0 || !is_unit(body.quaternion);
    for (Joint& joint : body.joints) {
      joint.centred = is_zero(joint.position);
      joint.along = joint.kind == JointKind::hinge ? one_of_three(joint.axis) : -1;
    }
    if (!body.joints.empty()) body.joints.back().last = true;
    most = std::max(most, body.joints.size());
  }
  anchors_.resize(3 * most);
}

void ForwardKinematics::update(const double* q) {
  if (q != a_.qpos) std::copy_n(q, nq_, a_.qpos);
  for (const Body& body : placed_.bodies) {
    place(body);
    write_axes(body);
  }
  for (const Attached& geom : placed_.geoms) {
    attach(geom, a_.geom_xpos + 3 * geom.id, a_.geom_xmat + 9 * geom.id);
  }
  for (const Attached& site : placed_.sites) {
    attach(site, a_.site_xpos + 3 * site.id, a_.site_xmat + 9 * site.id);
  }
  weigh();
}

void ForwardKinematics::place(const Body& body) {
  double *position = a_.xpos + 3 * body.id, *quaternion = a_.xquat + 4 * body.id;
  if (body.free) {
    const double* q = a_.qpos + body.joints[0].coordinate;
    std::copy_n(q, 3, position);
    std::copy_n(q, 3, anchors_.data());
    std::copy_n(q + 3, 4, quaternion);
  } else {
    hang(body, position, quaternion);
    double* anchor = anchors_.data();
    for (const Joint& joint : body.joints) {
      move(joint, anchor, position, quaternion);
      anchor += 3;
    }
  }
  normalize(quaternion);
  write_matrix(quaternion, a_.xmat + 9 * body.id);
}

void ForwardKinematics::require(const Poses& poses, const MovingParts& moving) const {
  MovingParts old = moving;
  std::vector<char> weighed(moving.bodies.size());
  const auto refuse = [](const char* kind, std::size_t id) {
    throw std::invalid_argument(std::string(kind) + ' ' + std::to_string(id) +
                                " is looked at, and is none of what the kinematics place");
  };
  const auto current = [&](int body) {
    if (old.bodies[body]) refuse("body", body);
  };
  for (const Body& body : placed_.bodies) {
    current(body.parent);
    old.bodies[body.id] = 0;
  }
  for (const Attached& geom : placed_.geoms) {
    current(geom.body);
    old.geoms[geom.id] = 0;
  }
  for (const Attached& site : placed_.sites) {
    current(site.body);
    old.sites[site.id] = 0;
  }
  for (const Mass& part : placed_.masses) {
    current(part.id);
    weighed[part.id] = 1;
  }
  // Where in an array of so many numbers for each of its things an address is, or −1.
  const auto index = [](const double* pose, const double* first, std::size_t count, int width) {
    const std::less<const double*> before;
    if (before(pose, first) || !before(pose, first + width * count)) return -1;
    return static_cast<int>((pose - first) / width);
  };
  for (const double* pose : poses) {
    const struct {
      const char* kind;
      const double* first;
      int width;
      const std::vector<char>& old;
    } arrays[] = {
        {"body", a_.xpos, 3, old.bodies},         {"body", a_.xquat, 4, old.bodies},
        {"body", a_.xmat, 9, old.bodies},         {"geom", a_.geom_xpos, 3, old.geoms},
        {"geom", a_.geom_xmat, 9, old.geoms},     {"site", a_.site_xpos, 3, old.sites},
        {"site", a_.site_xmat, 9, old.sites}};
    bool known = false;
    for (const auto& array : arrays) {
      const int id = index(pose, array.first, array.old.size(), array.width);
      if (id < 0) continue;
      known = true;
      if (array.old[id]) refuse(array.kind, id);
    }
    const int subtree = index(pose, a_.subtree_com, weighed.size(), 3);
    if (subtree >= 0 && !weighed[subtree]) refuse("subtree", subtree);
    if (!known && subtree < 0) throw std::invalid_argument("a pose is none of the kinematics' data");
  }
}

// Put a body where it is in its parent before its joints move it.
void ForwardKinematics::hang(const Body& body, double* position, double* quaternion) const {
  const double *offset = body.position, *turned = body.quaternion;
  const double *at = a_.xpos + 3 * body.parent, *carried = a_.xquat + 4 * body.parent;
  double own[4];
  if (body.mocap >= 0) {
    offset = a_.mocap_pos + 3 * body.mocap;
    std::copy_n(a_.mocap_quat + 4 * body.mocap, 4, own);
    normalize(own);
    turned = own;
  }
  if (body.shifted) {
    carry(a_.xmat + 9 * body.parent, offset, at, position);
  } else {
    std::copy_n(at, 3, position);
  }
  if (body.turned) {
    multiply(carried, turned, quaternion);
  } else {
    std::copy_n(carried, 4, quaternion);
  }
}

// Turn or shift a body by a joint, and write where the joint passes through, and its axis; but for
// an axis that is the body's own in the end.
void ForwardKinematics::move(const Joint& joint, double* anchor, double* position,
                             double* quaternion) {
  const double* q = a_.qpos + joint.coordinate;
  double* axis = a_.cdof + 6 * joint.dof;
  if (joint.kind != JointKind::ball && !(joint.along >= 0 && joint.last)) {
    turn(joint.axis, quaternion, axis);
  }
  if (joint.kind == JointKind::slide) {
    for (int i = 0; i < 3; ++i) position[i] += axis[i] * (*q - joint.zero);
    return;
  }
  if (joint.centred) {
    std::copy_n(position, 3, anchor);
  } else {
    turn(joint.position, quaternion, anchor);
    for (int i = 0; i < 3; ++i) anchor[i] += position[i];
  }
  if (joint.kind == JointKind::ball) {
    double turned[4];
    std::copy_n(q, 4, turned);
    normalize(turned);
    multiply(quaternion, turned, quaternion);
  } else {
    const double half = (*q - joint.zero) * 0.5, sine = std::sin(half), cosine = std::cos(half);
    if (joint.along >= 0) {
      turn_about(joint.along, cosine, joint.axis[joint.along] * sine, quaternion);
    } else {
      const double turned[4] = {cosine, joint.axis[0] * sine, joint.axis[1] * sine,
                                joint.axis[2] * sine};
      multiply(quaternion, turned, quaternion);
    }
  }
  if (joint.centred) return;
  turn(joint.position, quaternion, position);
  for (int i = 0; i < 3; ++i) position[i] = anchor[i] - position[i];
}

void ForwardKinematics::write_axes(const Body& body) {
  const double *from = a_.xpos + 3 * body.root, *anchor = anchors_.data();
  for (const Joint& joint : body.joints) {
    double* axes = a_.cdof + 6 * joint.dof;
    double offset[3];
    for (int i = 0; i < 3; ++i) offset[i] = from[i] - anchor[i];
    anchor += 3;
    switch (joint.kind) {
      case JointKind::slide:
        std::copy_n(axes, 3, axes + 3);
        std::fill_n(axes, 3, 0.0);
        continue;
      case JointKind::hinge:
        if (joint.along >= 0 && joint.last) {
          const double* column = a_.xmat + 9 * body.id + joint.along;
          for (int i = 0; i < 3; ++i) axes[i] = joint.axis[joint.along] * column[3 * i];
        }
        cross(axes, offset, axes + 3);
        continue;
      case JointKind::free:
        std::fill_n(axes, 18, 0.0);
        axes[3] = axes[10] = axes[17] = 1.0;
        axes += 18;
        break;
      case JointKind::ball:
        break;
    }
    const double* R = a_.xmat + 9 * body.id;
    for (int k = 0; k < 3; ++k, axes += 6) {
      for (int i = 0; i < 3; ++i) axes[i] = R[3 * i + k];
      cross(axes, offset, axes + 3);
    }
  }
}

void ForwardKinematics::attach(const Attached& part, double* position, double* rotation) const {
  const double *at = a_.xpos + 3 * part.body, *R = a_.xmat + 9 * part.body;
  if (part.shifted) {
    carry(R, part.position, at, position);
  } else {
    std::copy_n(at, 3, position);
  }
  if (part.turned) {
    double quaternion[4];
    multiply(a_.xquat + 4 * part.body, part.quaternion, quaternion);
    write_matrix(quaternion, rotation);
  } else {
    std::copy_n(R, 9, rotation);
  }
}

// Write the centres of mass of subtrees.
void ForwardKinematics::weigh() {
  for (const Mass& part : placed_.masses) std::fill_n(a_.subtree_com + 3 * part.id, 3, 0.0);
  for (const Mass& part : placed_.masses) {
    double *sum = a_.subtree_com + 3 * part.id, centre[3];
    if (part.shifted) {
      carry(a_.xmat + 9 * part.id, part.centre, a_.xpos + 3 * part.id, centre);
    } else {
      std::copy_n(a_.xpos + 3 * part.id, 3, centre);
    }
    for (int i = 0; i < 3; ++i) sum[i] += part.mass * centre[i];
    if (part.parent >= 0) {
      double* above = a_.subtree_com + 3 * part.parent;
      for (int i = 0; i < 3; ++i) above[i] += sum[i];
    }
    if (part.of_subtree < least) {
      std::copy_n(centre, 3, sum);
    } else {
      const double scale = 1.0 / part.of_subtree;
      for (int i = 0; i < 3; ++i) sum[i] *= scale;
    }
  }
}

}  // namespace rmrc
