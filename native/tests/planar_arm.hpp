// A planar arm whose kinematics stand in for MuJoCo's, with every kind of task and of limit.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <utility>
#include <vector>

#include "base/numbers.hpp"
#include "control/stepper.hpp"
#include "limits/collision.hpp"
#include "limits/workspace.hpp"
#include "tasks/axis.hpp"
#include "tasks/centre_of_mass.hpp"
#include "tasks/coupling.hpp"
#include "tasks/frame_terms.hpp"
#include "tasks/relative_frame.hpp"

namespace arm_tests {

using rmrc::infinity;
constexpr double pi = 3.141592653589793;
constexpr double kkt_tolerance = 1e-8;
constexpr double rounding = 1e-12;
constexpr int joints = 5;
constexpr double link = 0.3, dt = 0.002, fastest = 1.5, strongest = 20.0;
constexpr double radius = 0.05, ball[3] = {0.2, 1.1, 0.0};
constexpr double plane = 0.26;      // the least x of the end
constexpr double quickest = 1.2;     // m/s, of the end
constexpr double kept = 1e-6;        // rmrc.qp.rows.PASSED

// The arm in place of mjModel and mjData: hinges about z, and a frame at its end.
struct Arm {
  double q[joints] = {};
  double cdof[6 * joints] = {};
  double position[3] = {}, rotation[9] = {}, com[3] = {};
  // Of the world and the arm's end, each with one geom.
  double xpos[6] = {}, xquat[8] = {1, 0, 0, 0, 1, 0, 0, 0};
  double geom_xpos[6] = {ball[0], ball[1], ball[2]}, geom_xmat[18] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  double reference[6] = {};
};

inline rmrc::Kinematics arrays_of(Arm& arm) {
  return {&arm,          arm.q,         nullptr, nullptr,  arm.xpos,       arm.xquat,
          arm.geom_xpos, arm.geom_xmat, nullptr, arm.cdof, arm.reference};
}

inline Arm& arm_of(void* data) { return *static_cast<Arm*>(data); }

inline void kinematics(const void*, void* data) {
  Arm& arm = arm_of(data);
  double angle = 0.0, x = 0.0, y = 0.0;
  for (int i = 0; i < joints; ++i) {
    // The axis at the origin, which is the point that cdof refers to: the linear part is −z × p.
    double* axis = arm.cdof + 6 * i;
    axis[2] = 1.0;
    axis[3] = y;
    axis[4] = -x;
    angle += arm.q[i];
    x += link * std::cos(angle);
    y += link * std::sin(angle);
  }
  const double rotation[9] = {std::cos(angle), -std::sin(angle), 0, std::sin(angle),
                              std::cos(angle), 0, 0, 0, 1};
  std::copy_n(rotation, 9, arm.rotation);
  arm.position[0] = arm.xpos[3] = arm.geom_xpos[3] = x;
  arm.position[1] = arm.xpos[4] = arm.geom_xpos[4] = y;
  std::copy_n(rotation, 9, arm.geom_xmat + 9);
  arm.xquat[4] = std::cos(0.5 * angle);
  arm.xquat[7] = std::sin(0.5 * angle);
}

// Two spheres.
inline double distance(const void*, const void* data, int first, int second, double, double* segment) {
  const double* at = static_cast<const Arm*>(data)->geom_xpos;
  double apart[3], length = 0.0;
  for (int i = 0; i < 3; ++i) {
    apart[i] = at[3 * second + i] - at[3 * first + i];
    length += apart[i] * apart[i];
  }
  length = std::sqrt(length);
  for (int i = 0; i < 3; ++i) {
    segment[i] = at[3 * first + i] + radius / length * apart[i];
    segment[3 + i] = at[3 * second + i] - radius / length * apart[i];
  }
  return length - 2.0 * radius;
}

inline void com_pos(const void*, void*) {}

inline void make_inertia(const void*, void*) {}

inline void full_inertia(const void*, const void*, double* matrix) {
  std::fill_n(matrix, joints * joints, 0.0);
  for (int i = 0; i < joints; ++i) matrix[i * joints + i] = 1.0 + i;
}

inline void integrate(const void*, double* q, const double* v, double seconds) {
  for (int i = 0; i < joints; ++i) q[i] += seconds * v[i];
}

inline void differentiate(const void*, double* v, double seconds, const double* from, const double* to) {
  for (int i = 0; i < joints; ++i) v[i] = (to[i] - from[i]) / seconds;
}

constexpr int row_counts[] = {6, 6, 6, 3, 3, 3, 1, 10};
constexpr int rows = 38, error_size = rows + 2 * joints;

// All arrays of a problem with every kind of task, and the engine on them.
struct Fixture {
  Arm arm;
  double error[error_size] = {}, feedforward[error_size] = {}, rate[error_size] = {};
  std::vector<double> jacobian = std::vector<double>(rows * joints);
  std::vector<double> H = std::vector<double>(joints * joints);
  std::vector<double> inertia = std::vector<double>(joints * joints);
  double g[joints], lb[joints], ub[joints], v_previous[joints] = {}, a_previous[joints] = {};
  double added = 0.0, q[joints], v[joints] = {};
  int place[joints];
  double pose[7] = {std::cos(0.4), 0, 0, std::sin(0.4), 0.7, 0.5, 0.1};
  double offset[7] = {1, 0, 0, 0, 0.0, 0.0, 0.0}, point[3] = {1.0, 0.2, 0.0};
  double direction[3] = {0.6, 0.8, 0.0}, posture[joints] = {}, twist[6] = {0.1, 0, 0, 0, 0, 0.2};
  std::uint8_t moving = 1;
  std::unique_ptr<rmrc::Engine> engine;
  std::unique_ptr<rmrc::Stepper> stepper;

  // `others` is the root of all weights but that of the first task's position.
  explicit Fixture(rmrc::Adapt adapt, double others = 0.5, double jerk = 500.0)
      : others_(others) {
    for (int i = 0; i < joints; ++i) {
      place[i] = i;
      q[i] = 0.3 + 0.1 * i;
    }
    const rmrc::MuJoCo mujoco{
        {kinematics, com_pos, make_inertia, full_inertia, integrate, differentiate, distance},
        nullptr, &arm, joints, joints, arm.q, arm.cdof};
    std::vector<double> constant(joints * joints);
    for (int i = 0; i < joints; ++i) constant[i * joints + i] = 0.02;
    const auto every = [](double value) { return std::vector<double>(joints, value); };
    engine = std::make_unique<rmrc::Engine>(
        mujoco, rmrc::Stack{error, feedforward, jacobian.data(), v_previous, place},
        rmrc::ProgramArrays{H.data(), g, lb, ub, rate, &added, inertia.data(), a_previous},
        rmrc::Constants{{0, 1, 2, 3, 4}, constant, 1.0, 1e-3, 1e-4},
        rmrc::JointLimits{{0, 1, 2, 3, 4}, every(-2.0), every(2.0), 0.95, every(fastest),
                          every(strongest), every(jerk), every(infinity)},
        1000);
    add_tasks();
    std::vector<rmrc::TaskedRow> tasked;
    for (int r = 0; r < 6; ++r) tasked.push_back({0, r});
    engine->adapt({adapt, 0.3, 0.1, 3, 1.0}, tasked);
    rmrc::Progress progress({{0, std::vector<double>(6, 1.0), {1e-3, 1e-2}}}, 1e-2);
    stepper = std::make_unique<rmrc::Stepper>(
        *engine, std::move(progress), rmrc::ControllerState{q, v, v_previous}, std::vector<int>{},
        std::vector<char>(joints), infinity,
        std::vector<rmrc::KeptArray>{{error, error_size}, {pose, 7}}, rmrc::KeptFlags{&moving, 1});
  }

  rmrc::TermData data(int first, int count, const double* target) const {
    return {first, count, 5.0, target, twist, &moving, {}};
  }

  void add_tasks() {
    const std::vector<int> dofs{0, 1, 2, 3, 4};
    const rmrc::Frame end{arm.position, arm.rotation, arm.com, dofs};
    const rmrc::Frame base{arm.com, unit, arm.com, {}};
    const rmrc::MuJoCo& mujoco = engine->mujoco();
    const rmrc::Stack& stack = engine->stack();
    const auto ones = [&](int n) { return std::vector<double>(n, others_); };
    int first = 0;
    const auto next = [&](const double* target) {
      const int count = row_counts[term_++];
      const rmrc::TermData made = data(first, count, target);
      first += count;
      return made;
    };
    rmrc::TermData clamped = next(pose);
    clamped.clamps = {{0, 3, 0.05}, {3, 3, 0.2}};
    std::vector<double> full(36, 0.2 * others_);
    for (int i = 0; i < 6; ++i) full[7 * i] = i < 3 ? 1.0 : 2.0 * others_;
    engine->add(
        std::make_unique<rmrc::BodyFrame>(clamped, full, end, mujoco, stack));
    engine->add(std::make_unique<rmrc::WorldFrame>(next(pose), ones(6), end, mujoco, stack));
    engine->add(
        std::make_unique<rmrc::RelativeFrame>(next(offset), ones(6), end, base, mujoco, stack));
    engine->add(std::make_unique<rmrc::Axis>(next(point), ones(3), end, unit, true, mujoco, stack));
    engine->add(
        std::make_unique<rmrc::Axis>(next(direction), ones(3), end, unit, false, mujoco, stack));
    std::vector<rmrc::MovedMass> moved;
    for (const int dof : dofs) moved.push_back({dof, 0.2 * (joints - dof), arm.position, arm.com});
    const std::vector<rmrc::Subtree> whole{{1.0, arm.position, arm.com, nullptr}};
    engine->add(
        std::make_unique<rmrc::CentreOfMass>(next(point), ones(3), moved, whole, mujoco, stack));
    engine->add(std::make_unique<rmrc::Coupling>(
        next(point), ones(1), std::vector<double>{1, 1, 0, 0, 0},
        std::vector<double>{1, 1, 0, 0, 0},
        0.5, mujoco, stack));
    // Rows that others write: here they never change.
    for (int i = 0; i < 10 * joints; ++i) jacobian[first * joints + i] = 0.01 * (i % 7);
    engine->add(std::make_unique<rmrc::ForeignRows>(next(point), ones(10), mujoco, stack));
    engine->add(rmrc::JointTerm{data(first, joints, posture), rmrc::JointTask::posture,
                                std::vector<double>(joints, 0.01), {}});
    engine->add(rmrc::JointTerm{data(first + joints, joints, posture), rmrc::JointTask::smooth,
                                std::vector<double>(joints, 0.01), {}});
  }

 private:
  static constexpr double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  double others_;
  int term_ = 0;
};

constexpr double Fixture::unit[9];

inline bool ok = true;

inline void expect(bool holds, const char* what, int step) {
  if (holds) return;
  ok = false;
  std::printf("step %d: %s\n", step, what);
}

// The same arm with a pair of geoms, a plane, and a limit of its end's speed.
struct LimitedFixture : Fixture {
  static constexpr int capacity = 5 + rmrc::planes;
  Arm own;
  double matrix[capacity * joints], lower[capacity], upper[capacity], multiplier[capacity];
  std::int64_t ids[capacity];
  double distance[capacity], slope[capacity * joints], drift[capacity];
  std::int64_t geoms[2] = {0, 1}, body[2] = {0, 1}, root[2] = {0, 1}, mocap[2] = {-1, -1};
  std::int64_t dof_root[joints] = {1, 1, 1, 1, 1}, base[1] = {0}, other[1] = {1};
  std::uint8_t flat[1] = {0}, doubtful[1] = {0}, active[1] = {0}, measured[1] = {0};
  double size[6] = {radius, 0, 0, radius, 0, 0}, radii[1] = {2.0 * radius};
  double thickness[1] = {radius}, levers[joints], side[joints], reach[2] = {0.0, 2.0 * radius};
  double spread[1] = {0.0}, width[1] = {2.0 * radius}, sign[1] = {1.0}, carries[joints] = {};
  double apart[1] = {radius}, contacts[36] = {};
  std::int64_t contact_count[1] = {};
  double precision[2] = {1e-9, 1e-3}, moves[joints], bound[1] = {-infinity}, threshold[1] = {0.1}, between[1] = {};
  double segments[6] = {}, normals[3] = {}, room[1] = {-infinity}, travel[joints] = {};
  double position[6] = {}, quaternion[8] = {}, seen_position[6], seen_quaternion[8];
  std::unique_ptr<rmrc::Rows> rows;
  std::unique_ptr<rmrc::Shortening> shortening;

  // Without a limit of the jerk, with which the joints could not brake at once.
  LimitedFixture() : Fixture(rmrc::Adapt::off, 0.01, infinity) {
    for (int i = 0; i < joints; ++i) {
      levers[i] = link * (joints - i) + radius;
      side[i] = moves[i] = 1.0;
    }
    seen_position[0] = std::nan("");
    const std::vector<int> dofs{0, 1, 2, 3, 4};
    rows = std::make_unique<rmrc::Rows>(
        engine->mujoco(), arrays_of(arm), dofs, dofs, engine->joint_limits(), v_previous,
        rmrc::RowArrays{matrix, lower, upper, multiplier, ids, distance, slope, drift}, capacity);
    rows->add(rmrc::SpeedRows({arm.position, arm.rotation, arm.com, dofs}, false, quickest, infinity,
                              rate + 6, engine->stack().v_previous, rows->place(), joints,
                              arm.cdof));
    std::vector<rmrc::Plane> planes{{rmrc::Anchor::body, 1, 1, -1, {1.0, 0.0, 0.0}, plane, dofs,
                                     std::vector<double>(levers, levers + joints)}};
    rows->add(std::make_unique<rmrc::Workspace>(std::move(planes), 0.85, 0.1, nullptr, joints));
    rows->add(std::make_unique<rmrc::Collision>(pairs(), engine->mujoco()));
    shortening = std::make_unique<rmrc::Shortening>(*rows, arrays_of(own), nullptr, 0);
    engine->limit(*rows, shortening.get());
  }

  rmrc::PairArrays pairs() {
    rmrc::PairArrays a{};
    a.pairs = 1;
    a.bodies = 2;
    a.d_min = 0.01;
    a.detect = 0.1;
    a.gain = 0.85;
    a.push = 0.1;
    a.geoms = geoms;
    a.body = body;
    a.root = root;
    a.mocap = mocap;
    a.plane = flat;
    a.doubtful = doubtful;
    a.size = size;
    a.radii = radii;
    a.thickness = thickness;
    a.levers = a.longest = levers;
    a.side = side;
    a.dof_root = dof_root;
    a.reach = reach;
    a.base = base;
    a.other = other;
    a.spread = spread;
    a.width = width;
    a.sign = sign;
    a.carries = carries;
    a.moves = moves;
    a.precision = precision;
    a.apart = apart;
    a.contacts = contacts;
    a.contact_count = contact_count;
    a.bound = bound;
    a.threshold = threshold;
    a.distance = between;
    a.segments = segments;
    a.normals = normals;
    a.active = active;
    a.measured = measured;
    a.room = room;
    a.travel = travel;
    a.position = position;
    a.quaternion = quaternion;
    a.seen_position = seen_position;
    a.seen_quaternion = seen_quaternion;
    return a;
  }
};

}  // namespace arm_tests
