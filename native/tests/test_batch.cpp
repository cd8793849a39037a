// Steps of many planar arms on few threads: the same bits as alone, and without a call for memory.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "control/batch.hpp"
#include "control/status.hpp"
#include "tests/allocations.hpp"
#include "tests/planar_arm.hpp"

using namespace arm_tests;

namespace {

constexpr int elements = 150, bad_q = 17, bad_target = 40;

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
      const bool invalid = (out.flags[i] & rmrc::status::invalid_input) != 0;
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
  test_batch();
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
