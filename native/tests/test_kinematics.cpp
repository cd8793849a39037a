// Forward kinematics of a tree with every kind of joint: rigid in themselves, with axes that are
// those of differences, where nothing is written but what is asked for, and without a call for
// memory.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <utility>
#include <vector>

#include "kinematics/kinematics.hpp"
#include "tests/allocations.hpp"

namespace {

using rmrc::Body;
using rmrc::Joint;
using rmrc::JointKind;

constexpr int bodies = 5, coordinates = 10, dofs = 9;
constexpr double rounding = 1e-14;
constexpr double step = 1e-6, curvature = 1e-5;  // of differences, and what they are wrong by
constexpr double untouched = 7.0;

bool ok = true;

void expect(bool holds, const char* what, int run) {
  if (holds) return;
  std::printf("run %d: %s\n", run, what);
  ok = false;
}

// What an mjData has room for: the world, four bodies, one geom and one site.
struct Data {
  double q[coordinates] = {}, mocap_pos[3] = {}, mocap_quat[4] = {1, 0, 0, 0};
  double xpos[3 * bodies] = {}, xquat[4 * bodies] = {1}, xmat[9 * bodies] = {1, 0, 0, 0, 1,
                                                                           0, 0, 0, 1};
  double geom_xpos[3] = {}, geom_xmat[9] = {}, site_xpos[3] = {}, site_xmat[9] = {};
  double subtree_com[3 * bodies] = {}, cdof[6 * dofs] = {};
};

Joint joint(JointKind kind, int coordinate, int dof, double x, double y, double z, double aside) {
  Joint made{};
  made.kind = kind;
  made.coordinate = coordinate;
  made.dof = dof;
  const double axis[3] = {x, y, z};
  std::copy_n(axis, 3, made.axis);
  made.position[0] = aside;
  return made;
}

Body body(int id, int parent, std::vector<Joint> joints) {
  Body made{};
  made.id = id;
  made.parent = parent;
  made.root = 1;
  made.mocap = -1;
  made.position[0] = 0.3;
  made.quaternion[0] = 0.8;
  made.quaternion[2] = 0.6;
  made.joints = std::move(joints);
  return made;
}

// A free body, on it a slide and a hinge aside, and on that a hinge in the middle.
rmrc::ForwardKinematics tree(Data& d) {
  rmrc::Placed placed;
  placed.bodies = {body(1, 0, {joint(JointKind::free, 0, 0, 0, 0, 1, 0.0)}),
                   body(2, 1, {joint(JointKind::slide, 7, 6, 0, 0.6, 0.8, 0.0),
                               joint(JointKind::hinge, 8, 7, 0.6, 0, 0.8, 0.1)}),
                   body(3, 2, {joint(JointKind::hinge, 9, 8, 0, -1, 0, 0.0)})};
  placed.geoms = {{0, 3, true, true, {0.1, 0.2, 0.3}, {0, 1, 0, 0}}};
  placed.sites = {{0, 3, false, false, {}, {1, 0, 0, 0}}};
  placed.masses = {{3, 2, 1.0, 1.0, true, {0.2, 0, 0}}, {2, -1, 3.0, 4.0, false, {}}};
  return rmrc::ForwardKinematics(
      std::move(placed),
      {d.q, d.mocap_pos, d.mocap_quat, d.xpos, d.xquat, d.xmat, d.geom_xpos, d.geom_xmat,
       d.site_xpos, d.site_xmat, d.subtree_com, d.cdof},
      coordinates);
}

bool is_rotation(const double* R) {
  double wrong = 0.0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      double product = i == j ? -1.0 : 0.0;
      for (int k = 0; k < 3; ++k) product += R[3 * i + k] * R[3 * j + k];
      wrong = std::max(wrong, std::abs(product));
    }
  }
  return wrong < rounding;
}

// Whether the geom moves with a dof as the dof's axis says.
bool agrees(rmrc::ForwardKinematics& native, Data& d, int coordinate, int dof) {
  double before[3], after[3], q[coordinates];
  const double* axis = d.cdof + 6 * dof;
  std::copy_n(d.geom_xpos, 3, before);
  double arm[3], rate[3];
  for (int i = 0; i < 3; ++i) arm[i] = before[i] - d.xpos[3 + i];
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    rate[i] = axis[3 + i] + axis[j] * arm[k] - axis[k] * arm[j];
  }
  std::copy_n(d.q, coordinates, q);
  q[coordinate] += step;
  native.update(q);
  std::copy_n(d.geom_xpos, 3, after);
  q[coordinate] -= step;
  native.update(q);
  double wrong = 0.0;
  for (int i = 0; i < 3; ++i) {
    wrong = std::max(wrong, std::abs((after[i] - before[i]) / step - rate[i]));
  }
  return wrong < curvature;
}

void run(rmrc::ForwardKinematics& native, Data& d, std::mt19937& random, int number) {
  std::uniform_real_distribution<double> any(-3.0, 3.0);
  double q[coordinates];
  for (double& value : q) value = any(random);
  native.update(q);
  for (int b = 1; b <= 3; ++b) expect(is_rotation(d.xmat + 9 * b), "a body is bent", number);
  expect(is_rotation(d.geom_xmat), "a geom is bent", number);
  expect(std::equal(d.xpos + 9, d.xpos + 12, d.site_xpos), "a site is not where it is", number);
  for (int k = 0; k < 3; ++k) expect(agrees(native, d, k, k), "a free body's axis", number);
  for (int k = 6; k < dofs; ++k) expect(agrees(native, d, k + 1, k), "a joint's axis", number);
  for (int i = 0; i < 3; ++i) {
    const double mean = 0.75 * d.xpos[6 + i] + 0.25 * d.subtree_com[9 + i];
    expect(std::abs(mean - d.subtree_com[6 + i]) < rounding, "a centre of mass", number);
  }
}

}  // namespace

int main() {
  Data data;
  std::fill_n(data.xpos + 12, 3, untouched);
  rmrc::ForwardKinematics native = tree(data);
  std::mt19937 random(1);
  const long before = allocations;
  for (int k = 0; k < 1000; ++k) run(native, data, random, k);
  expect(allocations == before, "memory was asked for", -1);
  expect(data.xpos[12] == untouched, "a body was placed that nothing looks at", -1);
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
