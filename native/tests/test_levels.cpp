// Hard tasks and levels on random numbers: independent equalities, lexicographic optima inside the
// limits, preserved directions, and a loop's Jacobian; without a call for memory.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <vector>

#include "solver/cascade.hpp"
#include "tasks/equalities.hpp"
#include "tasks/loop.hpp"
#include "tests/allocations.hpp"

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double rounding = 1e-9;   // of sums and rotations of numbers of the order of 1
constexpr double difference = 1e-6;  // of a central difference with steps of 1e-6
constexpr int n = 7, limits_rows = 4, tasked = 3, directed = 3;

bool ok = true;

void expect(bool holds, const char* what, int at) {
  if (holds) return;
  ok = false;
  std::printf("%d: %s\n", at, what);
}

double product(const double* a, const double* b, int count) {
  double sum = 0.0;
  for (int i = 0; i < count; ++i) sum += a[i] * b[i];
  return sum;
}

class Random {
 public:
  void fill(std::vector<double>& values, double scale = 1.0) {
    for (double& value : values) value = scale * normal_(engine_);
  }

 private:
  std::mt19937 engine_{0};
  std::normal_distribution<double> normal_;
};

// Two levels inside a box, rows and an equality, all of which rest keeps.
struct Problem {
  std::vector<double> lb = std::vector<double>(n, -1.0), ub = std::vector<double>(n, 1.0);
  std::vector<double> C = std::vector<double>(limits_rows * n);
  std::vector<double> lo = std::vector<double>(limits_rows, -infinity);
  std::vector<double> hi = std::vector<double>(limits_rows, 0.5);
  std::vector<double> E = std::vector<double>(n), f = std::vector<double>(1);
  std::vector<double> first = std::vector<double>(tasked * n), wanted = std::vector<double>(tasked);
  std::vector<double> unit = std::vector<double>(n * n), aim = std::vector<double>(n);

  void draw(Random& random) {
    random.fill(C);
    random.fill(E);
    random.fill(first);
    random.fill(wanted);
    random.fill(aim);
    for (int i = 0; i < n; ++i) unit[i * n + i] = 1.0;
  }

  rmrc::Program limits() const {
    return {nullptr,   nullptr,  lb.data(), ub.data(),   C.data(), lo.data(),
            hi.data(), E.data(), f.data(),  limits_rows, 1};
  }

  std::vector<rmrc::Level> levels(bool preserved) const {
    const int along = preserved ? directed : 0;
    return {{tasked, first.data(), wanted.data(), nullptr, 1e-12, nullptr, along, first.data(),
             wanted.data()},
            {n, unit.data(), aim.data(), nullptr, 1e-12, nullptr, 0, nullptr, nullptr},
            {0, nullptr, nullptr, nullptr, 1.0, nullptr, 0, nullptr, nullptr}};
  }
};

void check_limits(const Problem& problem, const double* v, int at) {
  for (int i = 0; i < n; ++i) expect(std::abs(v[i]) <= 1.0, "outside the box", at);
  for (int r = 0; r < limits_rows; ++r) {
    expect(product(problem.C.data() + r * n, v, n) <= 0.5 + rounding, "a row is passed", at);
  }
  expect(std::abs(product(problem.E.data(), v, n)) <= rounding, "an equality is missed", at);
}

// The squared distance of a level's rows from what they ask for, at v.
double missed(const std::vector<double>& rows, const std::vector<double>& wanted, const double* v) {
  double sum = 0.0;
  for (std::size_t r = 0; r < wanted.size(); ++r) {
    const double by = product(rows.data() + r * n, v, n) - wanted[r];
    sum += by * by;
  }
  return sum;
}

void test_levels(bool preserved) {
  Random random;
  Problem problem;
  rmrc::Cascade cascade(n, {3, n, directed}, limits_rows, 1, 1000);
  rmrc::QPSolver alone(n, limits_rows, 1, 1000);
  std::vector<double> H(n * n), g(n);
  int solved = 0, slowed = 0, programs = 500;
  for (int k = 0; k < programs; ++k) {
    problem.draw(random);
    const std::vector<rmrc::Level> levels = problem.levels(preserved);
    const rmrc::Program limits = problem.limits();
    const long before = allocations;
    const bool found = cascade.solve(levels, limits, rmrc::Clock::time_point::max()) ==
                       rmrc::SolveStatus::solved;
    expect(allocations == before, "called for memory", k);
    if (!found) continue;
    ++solved;
    const double* v = cascade.v();
    check_limits(problem, v, k);
    if (preserved) {
      slowed += cascade.scale() < 1.0;
      for (int r = 0; r < directed; ++r) {
        const double got = product(problem.first.data() + r * n, v, n);
        expect(std::abs(got - cascade.scale() * problem.wanted[r]) <= difference, "turned aside", k);
      }
      continue;
    }
    // The first level is as near as it can be without the second.
    for (int i = 0; i < n; ++i) {
      g[i] = 0.0;
      for (int r = 0; r < tasked; ++r) g[i] -= problem.first[r * n + i] * problem.wanted[r];
      for (int j = 0; j < n; ++j) {
        H[i * n + j] = i == j ? 1e-9 : 0.0;
        for (int r = 0; r < tasked; ++r) {
          H[i * n + j] += problem.first[r * n + i] * problem.first[r * n + j];
        }
      }
    }
    rmrc::Program whole = limits;
    whole.H = H.data();
    whole.g = g.data();
    if (alone.solve(whole) != rmrc::SolveStatus::solved) continue;
    const double least = missed(problem.first, problem.wanted, alone.v());
    expect(missed(problem.first, problem.wanted, v) <= least + 1e-7, "a level gives way", k);
  }
  expect(solved * 10 > programs * 9, "too much is left to Python", solved);
  expect(!preserved || slowed > 0, "no direction is ever slowed", slowed);
}

// Rows there twice leave as many equalities as are independent, and contradictions are seen.
void test_equalities() {
  Random random;
  constexpr int rows = 6;
  std::vector<double> jacobian(rows * n), rate(rows), error(rows), v(n);
  std::vector<double> matrix(rows * n), right(rows), multiplier(rows), directions(rows * rows);
  std::vector<int> place(n), dofs(n);
  for (int i = 0; i < n; ++i) place[i] = dofs[i] = i;
  for (int i = 0; i < rows; ++i) directions[i * rows + i] = 1.0;
  const rmrc::Stack stack{error.data(), nullptr, jacobian.data(), nullptr, place.data()};
  rmrc::Equalities equalities(stack, rate.data(), n, dofs, std::vector<char>(n),
                              {{0, rows, directions, false, {}}},
                              {matrix.data(), right.data(), multiplier.data()});
  for (int k = 0; k < 500; ++k) {
    random.fill(jacobian);
    random.fill(v);
    std::copy_n(jacobian.begin(), n, jacobian.begin() + (rows - 1) * n);
    for (int r = 0; r < rows; ++r) rate[r] = product(jacobian.data() + r * n, v.data(), n);
    const long before = allocations;
    equalities.update(false, v.data());  // no joint is to stand still
    expect(allocations == before, "called for memory", k);
    expect(equalities.count() == rows - 1, "a wrong number of equalities", equalities.count());
    expect(!equalities.inconsistent(), "what agrees is called a contradiction", k);
    for (int r = 0; r < equalities.count(); ++r) {
      const double by = product(matrix.data() + r * n, v.data(), n) - right[r];
      expect(std::abs(by) <= rounding, "an equality is another", k);
    }
    rate[0] += 1e-3;
    equalities.update(false, v.data());  // no joint is to stand still
    expect(equalities.inconsistent(), "a contradiction is not seen", k);
  }
}

// A body that turns about z and one that slides along x, welded to each other.
struct Linkage {
  double q[2] = {}, cdof[12] = {};
  double position[2][3] = {}, rotation[2][9] = {}, quaternion[2][4] = {}, com[3] = {};

  void place() {
    const double c = std::cos(q[0]), s = std::sin(q[0]);
    const double turned[9] = {c, -s, 0, s, c, 0, 0, 0, 1};
    const double straight[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    std::copy_n(turned, 9, rotation[0]);
    std::copy_n(straight, 9, rotation[1]);
    quaternion[0][0] = std::cos(0.5 * q[0]);
    quaternion[0][3] = std::sin(0.5 * q[0]);
    quaternion[1][0] = 1.0;
    position[1][0] = q[1];
    cdof[2] = cdof[9] = 1.0;
  }
};

void test_loop() {
  Linkage linkage;
  std::vector<double> error(7), feedforward(7), jacobian(14);
  const int place[2] = {0, 1};
  const rmrc::Stack stack{error.data(), feedforward.data(), jacobian.data(), nullptr, place};
  const rmrc::MuJoCo mujoco{{}, nullptr, nullptr, 2, 2, linkage.q, linkage.cdof};
  const auto end = [&](int body, double x, double y) {
    const rmrc::Frame frame{linkage.position[body], linkage.rotation[body], linkage.com, {body}};
    return rmrc::Anchorage{frame, linkage.quaternion[body], {x, y, 0.1}, {1, 0, 0, 0}};
  };
  const std::uint8_t moving = 0;
  rmrc::Loop loop({0, 7, 1.0, nullptr, nullptr, &moving, {}}, std::vector<double>(7, 1.0),
                  {{0, true, 0.7, {end(0, 0.3, 0.1), end(1, 0.2, 0.4)}}},
                  {{6, {{{0, 0, 1.0}}, 0.2}, {{{1, 1, 2.0}}, 0.1}, {0.1, 0.5, -0.3, 0.2, 0.4}}},
                  std::vector<double>(7, 1.0), {0, 0, 0, 1, 1, 1, 1}, mujoco, stack);
  const auto evaluated = [&](double first, double second) {
    linkage.q[0] = first;
    linkage.q[1] = second;
    linkage.place();
    loop.evaluate();
    return error;
  };
  constexpr double h = 1e-6;
  for (int k = 0; k < 50; ++k) {
    const double q[2] = {0.1 * k - 2.0, 0.3 - 0.02 * k};
    for (int dof = 0; dof < 2; ++dof) {
      const double by[2] = {dof == 0 ? h : 0.0, dof == 1 ? h : 0.0};
      const std::vector<double> after = evaluated(q[0] + by[0], q[1] + by[1]);
      const std::vector<double> before = evaluated(q[0] - by[0], q[1] - by[1]);
      evaluated(q[0], q[1]);
      for (int r = 0; r < 7; ++r) {
        const double slope = (before[r] - after[r]) / (2.0 * h);  // e = −r
        expect(std::abs(slope - jacobian[2 * r + dof]) <= difference, "a wrong Jacobian", r);
      }
    }
  }
}

}  // namespace

int main() {
  test_levels(false);
  test_levels(true);
  test_equalities();
  test_loop();
  std::puts(ok ? "ok" : "failed");
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}
