// Steps of a planar arm, whose kinematics stand in for MuJoCo's: optimal, inside the box, in front
// of a plane and away from a ball, the same again bit by bit, and without a call for memory; and
// those of many arms on few threads.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "control/batch.hpp"
#include "control/stepper.hpp"
#include "limits/workspace.hpp"
#include "tests/allocations.hpp"

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
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

rmrc::Kinematics arrays_of(Arm& arm) {
  return {&arm,          arm.q,         nullptr, nullptr,  arm.xpos,       arm.xquat,
          arm.geom_xpos, arm.geom_xmat, nullptr, arm.cdof, arm.reference};
}

Arm& arm_of(void* data) { return *static_cast<Arm*>(data); }

void kinematics(const void*, void* data) {
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
double distance(const void*, const void* data, int first, int second, double, double* segment) {
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

void com_pos(const void*, void*) {}

void make_inertia(const void*, void*) {}

void full_inertia(const void*, const void*, double* matrix) {
  std::fill_n(matrix, joints * joints, 0.0);
  for (int i = 0; i < joints; ++i) matrix[i * joints + i] = 1.0 + i;
}

void integrate(const void*, double* q, const double* v, double seconds) {
  for (int i = 0; i < joints; ++i) q[i] += seconds * v[i];
}

void differentiate(const void*, double* v, double seconds, const double* from, const double* to) {
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

bool ok = true;

void expect(bool holds, const char* what, int step) {
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

std::vector<double> run_limited(int steps) {
  LimitedFixture fixture;
  constexpr int at_first = rmrc::planes;  // the row of the plane; the ball's comes after
  std::vector<double> out(fixture.stepper->size() + 4 * LimitedFixture::capacity), history;
  history.reserve(static_cast<std::size_t>(steps) * joints);
  rmrc::Summary summary;
  int relaxed = 0, at_plane = 0, at_ball = 0, shortened = 0, corrected = 0;
  for (int k = 0; k < steps; ++k) {
    if (k % 500 == 0) {  // to the ball, to the plane, and away
      const double aims[3][2] = {{ball[0], ball[1]}, {-1.2, 0.3}, {1.0, 0.5}};
      std::copy_n(aims[k / 500 % 3], 2, fixture.pose + 4);
      fixture.moving = 0;
    }
    const long before = allocations;
    const bool taken = fixture.stepper->step(nullptr, dt, summary);
    if (taken) fixture.stepper->write(out.data());
    expect(allocations == before, "called for memory beside limits", k);
    shortened += fixture.engine->share() < 1.0;
    for (int r = at_first; r < fixture.rows->count(); ++r) {
      corrected += fixture.engine->moved() && fixture.engine->lower()[r] > fixture.lower[r];
    }
    expect(taken, "not taken beside limits", k);
    relaxed += fixture.engine->relaxed();
    double segment[6];
    kinematics(nullptr, &fixture.arm);
    const double* at = fixture.distance;
    const int count = fixture.rows->count();
    expect(at[at_first] >= -kept, "beyond the plane", k);
    if (count > at_first + 1) expect(at[at_first + 1] >= -kept, "in the ball", k);
    expect(distance(nullptr, &fixture.arm, 0, 1, infinity, segment) >= 0.01 - kept, "too near", k);
    at_plane += fixture.multiplier[at_first] < -1e-7;
    at_ball += count > at_first + 1 && fixture.multiplier[at_first + 1] < -1e-7;
    history.insert(history.end(), fixture.v, fixture.v + joints);
  }
  expect(relaxed * 100 < steps, "too much is relaxed", relaxed);
  expect(shortened > 0 && corrected > 0, "no command is ever shortened", shortened);
  expect(at_plane > 0 && at_ball > 0, "no limit is ever active", at_plane);
  return history;
}

std::vector<double> run(rmrc::Adapt adapt, int steps) {
  Fixture fixture(adapt);
  std::vector<double> out(fixture.stepper->size()), history;
  history.reserve(static_cast<std::size_t>(steps) * joints);
  rmrc::Summary summary;
  for (int k = 0; k < steps; ++k) {
    if (k % 500 == 0) {  // within reach, out of it, and turned around
      const double angle = 0.4 * k / 500.0 * pi;
      fixture.pose[0] = std::cos(0.5 * angle);
      fixture.pose[3] = std::sin(0.5 * angle);
      fixture.pose[4] = 2.0 * std::cos(angle);
      fixture.pose[5] = 2.0 * std::sin(angle);
      fixture.moving = k % 1000 == 0;
    }
    const long before = allocations;
    expect(fixture.stepper->step(nullptr, dt, summary), "not taken", k);
    fixture.stepper->write(out.data());
    expect(allocations == before, "called for memory", k);
    expect(summary.ending == rmrc::Ending::solved, "not solved", k);
    for (int i = 0; i < 3; ++i) expect(out[i] <= kkt_tolerance, "not optimal", k);
    for (int i = 0; i < joints; ++i) {
      expect(std::abs(fixture.v[i]) <= fastest + rounding, "too fast", k);
      const double change = std::abs(fixture.v[i] - fixture.v_previous[i]);
      expect(change <= strongest * dt + rounding, "too abrupt", k);
      history.push_back(fixture.v[i]);
    }
  }
  return history;
}

void test_bad_input() {
  Fixture fixture(rmrc::Adapt::off);
  rmrc::Summary summary;
  double q[joints] = {0, 0, std::nan(""), 0, 0};
  expect(!fixture.stepper->step(q, dt, summary), "a q that is not finite is taken", 0);
  fixture.pose[4] = std::nan("");
  fixture.stepper->step(nullptr, dt, summary);
  expect(summary.ending == rmrc::Ending::failed, "a target that is not finite is taken", 0);
  for (const double v : fixture.v) expect(std::isfinite(v), "v is not finite", 0);
}

constexpr int elements = 150, bad_q = 17, bad_target = 40;
constexpr unsigned invalid_input = 1u << 10;  // rmrc.control.status.Status

// What came out of a batch: v of all steps, and the flags.
struct Rows {
  std::vector<double> v;
  std::vector<std::int32_t> flags;
  bool operator==(const Rows&) const = default;
};

// The target of an element: some are within reach, some are not.
void pose_of(int element, double* pose) {
  const double angle = 0.05 * element;
  pose[0] = (element % 3 + 0.5) * 0.8 * std::cos(angle);
  pose[1] = (element % 3 + 0.5) * 0.8 * std::sin(angle);
  pose[2] = 0.0;
  pose[3] = element == bad_target ? std::nan("") : 1.0;
  pose[4] = pose[5] = pose[6] = 0.0;
}

Rows run_batch(int threads, int steps) {
  std::vector<std::unique_ptr<Fixture>> fixtures;
  std::vector<rmrc::Worker> workers;
  for (int thread = 0; thread < threads; ++thread) {
    fixtures.push_back(std::make_unique<Fixture>(rmrc::Adapt::sigma_min));
    Fixture& own = *fixtures.back();
    workers.push_back({own.stepper.get(), own.pose, own.twist, &own.moving});
  }
  const Fixture& first = *fixtures[0];
  rmrc::Batch batch(elements, workers, std::vector<double>(first.pose, first.pose + 7), 1);
  std::vector<double> q(elements * joints), v(q.size()), poses(elements * 7);
  for (int i = 0; i < elements; ++i) {
    std::copy_n(first.q, joints, q.begin() + i * joints);
    pose_of(i, poses.data() + 7 * i);
  }
  batch.reset(q.data(), v.data());
  std::vector<std::uint8_t> accepted(elements);
  batch.aim({0, 0, true}, poses.data(), nullptr, accepted.data());
  for (int i = 0; i < elements; ++i) {
    expect((accepted[i] != 0) == (i != bad_target), "a target is taken for another's", -1);
  }
  Rows rows{std::vector<double>(steps * v.size()), std::vector<std::int32_t>(steps * elements)};
  for (int k = 0; k < steps; ++k) {
    const bool measured = k % 50 == 49;
    if (measured) q[bad_q * joints + 2] = std::nan("");
    const rmrc::BatchOutput out{rows.v.data() + k * v.size(), q.data(),
                                rows.flags.data() + k * elements};
    const long before = allocations;
    batch.step(measured ? q.data() : nullptr, dt, out);
    expect(allocations == before, "a batch called for memory", k);
    for (int i = 0; i < elements; ++i) {
      const bool invalid = (out.flags[i] & invalid_input) != 0;
      expect(invalid == ((i == bad_q && measured) || (i == bad_target && k == 0)),
             "an element's failure is another's", k);
    }
  }
  return rows;
}

void test_batch() {
  constexpr int steps = 200;
  const Rows rows = run_batch(1, steps);
  for (const int threads : {2, 3}) {
    expect(run_batch(threads, steps) == rows, "more threads give other bits", -1);
  }
  for (const int element : {0, 1, 2, elements - 1}) {
    Fixture alone(rmrc::Adapt::sigma_min);
    double pose[7];
    pose_of(element, pose);
    const rmrc::Aim aim{true, alone.pose, alone.twist, &alone.moving};
    expect(aim.take({pose, pose + 3, nullptr}), "a target is not taken", element);
    rmrc::Summary summary;
    for (int k = 0; k < steps; ++k) {
      alone.stepper->step(nullptr, dt, summary);
      const double* v = rows.v.data() + (k * elements + element) * joints;
      expect(std::equal(v, v + joints, alone.v), "an element is not as if it were alone", k);
    }
  }
}

}  // namespace

int main() {
  for (const rmrc::Adapt adapt : {rmrc::Adapt::off, rmrc::Adapt::sigma_min,
                                  rmrc::Adapt::manipulability, rmrc::Adapt::error}) {
    expect(run(adapt, 3000) == run(adapt, 3000), "another run gives other bits", -1);
  }
  expect(run_limited(3000) == run_limited(3000), "another run beside limits gives other bits", -1);
  test_bad_input();
  test_batch();
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
