// Steps of a planar arm, whose kinematics stand in for MuJoCo's: optimal, inside the box, the same
// again bit by bit, and without a call for memory.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <memory>
#include <new>
#include <vector>

#include "stepper.hpp"

namespace {

std::atomic<long> allocations{0};

}  // namespace

void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double pi = 3.141592653589793;
constexpr double kkt_tolerance = 1e-8;
constexpr double rounding = 1e-12;
constexpr int joints = 5;
constexpr double link = 0.3, dt = 0.002, fastest = 1.5, strongest = 20.0;

// The arm in place of mjModel and mjData: hinges about z, and a frame at its end.
struct Arm {
  double q[joints] = {};
  double cdof[6 * joints] = {};
  double position[3] = {}, rotation[9] = {}, com[3] = {};
};

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
  arm.position[0] = x;
  arm.position[1] = y;
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

constexpr int row_counts[] = {6, 6, 6, 3, 3, 3, 1};
constexpr int rows = 28, error_size = rows + 2 * joints;

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

  explicit Fixture(rmrc::Adapt adapt) {
    for (int i = 0; i < joints; ++i) {
      place[i] = i;
      q[i] = 0.3 + 0.1 * i;
    }
    const rmrc::MuJoCo mujoco{
        {kinematics, com_pos, make_inertia, full_inertia, integrate, differentiate},
        nullptr, &arm, joints, joints, arm.q, arm.cdof};
    std::vector<double> constant(joints * joints);
    for (int i = 0; i < joints; ++i) constant[i * joints + i] = 0.02;
    const auto every = [](double value) { return std::vector<double>(joints, value); };
    engine = std::make_unique<rmrc::Engine>(
        mujoco, rmrc::Stack{error, feedforward, jacobian.data(), v_previous, place},
        rmrc::ProgramArrays{H.data(), g, lb, ub, rate, &added, inertia.data(), a_previous},
        rmrc::Constants{{0, 1, 2, 3, 4}, constant, 1.0, 1e-3, 1e-4},
        rmrc::JointLimits{{0, 1, 2, 3, 4}, every(-2.0), every(2.0), 0.95, every(fastest),
                          every(strongest), every(500.0)},
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
    const auto ones = [](int n) { return std::vector<double>(n, 0.5); };
    int first = 0;
    const auto next = [&](const double* target) {
      const int count = row_counts[term_++];
      const rmrc::TermData made = data(first, count, target);
      first += count;
      return made;
    };
    rmrc::TermData clamped = next(pose);
    clamped.clamps = {{0, 3, 0.05}, {3, 3, 0.2}};
    std::vector<double> full(36, 0.1);
    for (int i = 0; i < 6; ++i) full[7 * i] = 1.0;
    engine->add(std::make_unique<rmrc::BodyFrame>(clamped, full, end, mujoco, stack));
    engine->add(std::make_unique<rmrc::WorldFrame>(next(pose), ones(6), end, mujoco, stack));
    engine->add(
        std::make_unique<rmrc::RelativeFrame>(next(offset), ones(6), end, base, mujoco, stack));
    engine->add(std::make_unique<rmrc::Axis>(next(point), ones(3), end, unit, true, mujoco, stack));
    engine->add(
        std::make_unique<rmrc::Axis>(next(direction), ones(3), end, unit, false, mujoco, stack));
    std::vector<rmrc::MovedMass> moved;
    for (const int dof : dofs) moved.push_back({dof, 0.2 * (joints - dof), arm.position, arm.com});
    engine->add(std::make_unique<rmrc::CentreOfMass>(next(point), ones(3), moved,
                                                     std::vector<double>{1.0},
                                                     std::vector<const double*>{arm.position},
                                                     mujoco, stack));
    engine->add(std::make_unique<rmrc::Coupling>(
        next(point), ones(1), std::vector<double>{1, 1, 0, 0, 0},
        std::vector<double>{1, 1, 0, 0, 0},
        0.5, mujoco, stack));
    engine->add(rmrc::JointTerm{data(first, joints, posture), rmrc::JointTask::posture,
                                std::vector<double>(joints, 0.01)});
    engine->add(rmrc::JointTerm{data(first + joints, joints, posture), rmrc::JointTask::smooth,
                                std::vector<double>(joints, 0.01)});
  }

 private:
  static constexpr double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  int term_ = 0;
};

constexpr double Fixture::unit[9];

bool ok = true;

void expect(bool holds, const char* what, int step) {
  if (holds) return;
  ok = false;
  std::printf("step %d: %s\n", step, what);
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

}  // namespace

int main() {
  for (const rmrc::Adapt adapt : {rmrc::Adapt::off, rmrc::Adapt::sigma_min,
                                  rmrc::Adapt::manipulability, rmrc::Adapt::error}) {
    expect(run(adapt, 3000) == run(adapt, 3000), "another run gives other bits", -1);
  }
  test_bad_input();
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
