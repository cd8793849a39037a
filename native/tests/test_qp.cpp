// Random programs, warm and cold: optimal by their own residuals, without a call for memory.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <vector>

#include "solver/least_violation.hpp"
#include "solver/qp.hpp"
#include "tests/allocations.hpp"

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double kkt_tolerance = 1e-8;

struct Arrays {
  int n, rows, equalities;
  std::vector<double> H, g, lb, ub, C, lo, hi, E, f, feasible;

  Arrays(int n_, int rows_, int equalities_)
      : n(n_),
        rows(rows_),
        equalities(equalities_),
        H(n * n),
        g(n),
        lb(n),
        ub(n),
        C(rows * n),
        lo(rows),
        hi(rows),
        E(equalities * n),
        f(equalities),
        feasible(n) {}

  rmrc::Program program() const {
    return {H.data(),  g.data(),  lb.data(), ub.data(), C.data(),  lo.data(),
            hi.data(), E.data(), f.data(),  rows,      equalities};
  }
};

double product(const double* a, const std::vector<double>& v) {
  double sum = 0.0;
  for (std::size_t i = 0; i < v.size(); ++i) sum += a[i] * v[i];
  return sum;
}

// A feasible program with fixed variables, absent limits, rows that are there twice and rows of 0.
void fill(Arrays& p, std::mt19937_64& random, bool rank_deficient) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const int n = p.n, terms = rank_deficient ? n / 2 + 1 : 2 * n;
  std::vector<double> jacobian(terms * n), rate(terms);
  for (double& value : jacobian) value = normal(random);
  for (double& value : rate) value = 3.0 * normal(random);
  for (int i = 0; i < n; ++i) {
    p.g[i] = 0.0;
    for (int t = 0; t < terms; ++t) p.g[i] -= jacobian[t * n + i] * rate[t];
    for (int j = 0; j < n; ++j) {
      double sum = i == j ? (rank_deficient ? 1e-12 : 1e-4) : 0.0;
      for (int t = 0; t < terms; ++t) sum += jacobian[t * n + i] * jacobian[t * n + j];
      p.H[i * n + j] = sum;
    }
    p.feasible[i] = 0.5 * normal(random);
    const double kind = uniform(random);
    p.lb[i] = kind < 0.1 ? p.feasible[i] : p.feasible[i] - uniform(random);
    p.ub[i] = kind < 0.1 ? p.feasible[i] : p.feasible[i] + uniform(random);
    if (kind > 0.9 && !rank_deficient) p.ub[i] = infinity;
  }
  for (double& value : p.C) value = normal(random);
  for (int r = 0; r < p.rows; ++r) {
    double* row = p.C.data() + r * n;
    if (r % 4 == 3) std::copy(row - n, row, row);
    if (r % 8 == 6) std::fill(row, row + n, 0.0);
    const double activity = product(row, p.feasible);
    p.lo[r] = uniform(random) < 0.5 ? -infinity : activity - uniform(random);
    p.hi[r] = uniform(random) < 0.1 ? std::max(p.lo[r], activity) : activity + uniform(random);
  }
  for (double& value : p.E) value = normal(random);
  for (int r = 0; r < p.equalities; ++r) {
    double* row = p.E.data() + r * n;
    if (r % 3 == 2) {
      for (int i = 0; i < n; ++i) row[i] = row[i - n] - 2.0 * row[i - 2 * n];
    }
    p.f[r] = product(row, p.feasible);
  }
}

// The largest of the residuals of the optimality conditions.
double residual(const Arrays& p, const rmrc::QPSolver& solver) {
  const std::vector<double> v(solver.v(), solver.v() + p.n);
  double worst = 0.0;
  const auto limit = [&](double value, double lower, double upper, double multiplier) {
    worst = std::max({worst, lower - value, value - upper});
    if (multiplier > 0.0) worst = std::max(worst, multiplier * std::abs(upper - value));
    if (multiplier < 0.0) worst = std::max(worst, -multiplier * std::abs(value - lower));
  };
  for (int i = 0; i < p.n; ++i) {
    limit(v[i], p.lb[i], p.ub[i], solver.bound_multiplier()[i]);
    double sum = p.g[i] + solver.bound_multiplier()[i] + product(p.H.data() + i * p.n, v);
    for (int r = 0; r < p.rows; ++r) sum += solver.row_multiplier()[r] * p.C[r * p.n + i];
    for (int r = 0; r < p.equalities; ++r) {
      sum += solver.equality_multiplier()[r] * p.E[r * p.n + i];
    }
    worst = std::max(worst, std::abs(sum));
  }
  for (int r = 0; r < p.rows; ++r) {
    limit(product(p.C.data() + r * p.n, v), p.lo[r], p.hi[r], solver.row_multiplier()[r]);
  }
  for (int r = 0; r < p.equalities; ++r) {
    worst = std::max(worst, std::abs(product(p.E.data() + r * p.n, v) - p.f[r]));
  }
  return std::isfinite(worst) ? worst : infinity;
}

int failures = 0;

void expect(bool holds, const char* what, int n, int rows, int k) {
  if (holds) return;
  ++failures;
  std::printf("%s: n %d, rows %d, program %d\n", what, n, rows, k);
}

void check_sizes(int n, int rows, int equalities, std::mt19937_64& random) {
  Arrays p(n, rows, equalities);
  rmrc::QPSolver solver(n, rows, equalities, 10000);
  for (int k = 0; k < 40; ++k) {
    fill(p, random, k % 4 == 3);
    const rmrc::Program program = p.program();
    const long before = allocations;
    const rmrc::SolveStatus status = solver.solve(program);  // warm, from an unrelated program
    const rmrc::SolveStatus again = solver.solve(program);
    expect(allocations == before, "a solve has called for memory", n, rows, k);
    expect(status == rmrc::SolveStatus::solved && again == status, "not solved", n, rows, k);
    expect(residual(p, solver) <= kkt_tolerance, "not optimal", n, rows, k);
    // A program that cannot be solved, and the next solve after it.
    std::swap(p.lb[0], p.ub[0]);
    p.ub[0] -= 1.0;
    expect(solver.solve(program) == rmrc::SolveStatus::infeasible, "not infeasible", n, rows, k);
    std::swap(p.lb[0], p.ub[0]);
    p.lb[0] += 1.0;
    p.g[0] = std::numeric_limits<double>::quiet_NaN();
    expect(solver.solve(program) == rmrc::SolveStatus::failed, "a NaN is solved", n, rows, k);
  }
}

// ‖[s; t]‖ at v, and by how much it passes what no slack is for, the box and what the brake keeps.
struct Violation {
  double least, beyond;
};

Violation violation(const Arrays& p, const std::vector<double>& v,
                    const std::vector<double>& brake) {
  double square = 0.0, beyond = 0.0;
  for (int i = 0; i < p.n; ++i) beyond = std::max({beyond, p.lb[i] - v[i], v[i] - p.ub[i]});
  for (int r = 0; r < p.rows; ++r) {
    const double at = product(p.C.data() + r * p.n, v);
    const double braked = product(p.C.data() + r * p.n, brake);
    beyond = std::max({beyond, std::min(p.lo[r], braked) - at, at - std::max(p.hi[r], braked)});
    const double by = std::max({p.lo[r] - at, at - p.hi[r], 0.0});
    square += by * by;
  }
  for (int r = 0; r < p.equalities; ++r) {
    const double by = product(p.E.data() + r * p.n, v) - p.f[r];
    square += by * by;
  }
  return {std::sqrt(square), beyond};
}

// Rows that ask for more than the box allows: no v beside the one found violates them less.
void check_relaxed(int n, int rows, int equalities, std::mt19937_64& random) {
  constexpr double moved = 1e-3, rounding = 1e-8;
  std::normal_distribution<double> normal;
  Arrays p(n, rows, equalities);
  rmrc::LeastViolation least(n, rows, equalities);
  std::vector<double> brake(n), v(n), lower(rows), upper(rows), right(equalities);
  for (int k = 0; k < 20; ++k) {
    fill(p, random, false);
    for (int r = 0; r < rows; ++r) {
      p.lo[r] = normal(random);
      p.hi[r] = infinity;
    }
    for (double& value : p.f) value = 5.0 * normal(random);
    for (int i = 0; i < n; ++i) {
      p.lb[i] = std::max(p.lb[i], -2.0);
      p.ub[i] = std::min(p.ub[i], 2.0);
      brake[i] = std::min(std::max(0.0, p.lb[i]), p.ub[i]);
    }
    const long before = allocations;
    const bool found =
        least.find(p.program(), brake.data(), rmrc::Clock::time_point::max());
    expect(found, "the least violation is not found", n, rows, k);
    least.relax(lower.data(), upper.data(), right.data());
    expect(allocations == before, "the least violation has called for memory", n, rows, k);
    v.assign(least.v(), least.v() + n);
    const Violation best = violation(p, v, brake);
    expect(std::abs(best.least - least.violation()) <= rounding, "misjudged", n, rows, k);
    expect(best.beyond <= rounding, "beyond what the brake keeps", n, rows, k);
    for (int r = 0; r < rows; ++r) {
      expect(product(p.C.data() + r * n, v) >= lower[r], "not feasible once relaxed", n, rows, k);
    }
    for (int trial = 0; trial < 50; ++trial) {
      std::vector<double> other = v;
      const double share = trial % 2 == 0 ? moved : 1.0;  // beside it, or on the way to the brake
      for (int i = 0; i < n; ++i) {
        const double step = trial % 2 == 0 ? normal(random) : 0.02 * trial * (brake[i] - v[i]);
        other[i] = std::min(std::max(v[i] + share * step, p.lb[i]), p.ub[i]);
      }
      const Violation there = violation(p, other, brake);
      expect(there.beyond > 0.0 || there.least >= best.least - rounding, "not the least", n, rows, k);
    }
    expect(!least.find(p.program(), brake.data(), rmrc::Clock::time_point::min()) ||
               best.least == 0.0,
           "found without time", n, rows, k);
  }
}

}  // namespace

// The seed of the programs may be given: other seeds, other programs.
int main(int count, char** arguments) {
  std::mt19937_64 random(count > 1 ? std::strtoull(arguments[1], nullptr, 10) : 0);
  for (const int n : {1, 2, 3, 4, 5, 7, 8, 16, 31, 43}) {
    check_sizes(n, 0, 0, random);
    check_sizes(n, n, 0, random);
    check_sizes(n, 3 * n, n / 3, random);
  }
  check_sizes(100, 40, 12, random);
  for (const int n : {1, 2, 7, 24}) {
    check_relaxed(n, 0, n, random);
    check_relaxed(n, 2 * n, 0, random);
    check_relaxed(n, 8 * n, 2, random);
  }
  std::printf("%d failures\n", failures);
  return failures == 0 ? 0 : 1;
}
