// Steps of a planar arm: optimal, inside the box, in front of a plane and away from a ball, the same
// again bit by bit, and without a call for memory.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "tests/allocations.hpp"
#include "tests/planar_arm.hpp"

using namespace arm_tests;

namespace {

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
    expect(summary.ending == rmrc::SolveStatus::solved, "not solved", k);
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
  expect(summary.ending == rmrc::SolveStatus::failed, "a target that is not finite is taken", 0);
  for (const double v : fixture.v) expect(std::isfinite(v), "v is not finite", 0);
}

}  // namespace

int main() {
  for (const rmrc::Adapt adapt : {rmrc::Adapt::off, rmrc::Adapt::sigma_min,
                                  rmrc::Adapt::manipulability, rmrc::Adapt::error}) {
    expect(run(adapt, 3000) == run(adapt, 3000), "another run gives other bits", -1);
  }
  expect(run_limited(3000) == run_limited(3000), "another run beside limits gives other bits", -1);
  test_bad_input();
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
