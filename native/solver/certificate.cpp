#include "solver/certificate.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// Σ m⁺(upper − x) + m⁻(x − lower) of one multiplier m, and m² where that limit is infinite.
struct Slackness {
  double sum = 0.0, stray = 0.0;

  void add(double m, double x, double lower, double upper) {
    if (m == 0.0) return;
    const double distance = m > 0.0 ? upper - x : x - lower;
    if (std::isinf(distance)) {
      stray += m * m;
    } else {
      sum += std::abs(m) * distance;
    }
  }
};

}  // namespace

Residuals certify(int n, const Program& program, const double* z, const double* y, const double* w,
                  double* v, double* residual, const double* gradient) {
  const Program& p = program;
  double primal = 0.0;
  Slackness slack;
  for (int i = 0; i < n; ++i) {
    const double inside = std::min(std::max(v[i], p.lb[i]), p.ub[i]);
    primal += (v[i] - inside) * (v[i] - inside);
    v[i] = inside;
  }
  // Of a v that had to be moved into the box, no gradient is known.
  const bool known = gradient != nullptr && primal == 0.0;
  for (int i = 0; i < n; ++i) {
    residual[i] = (known ? gradient[i] : dot(p.H + i * n, v, n) + p.g[i]) + z[i];
    slack.add(z[i], v[i], p.lb[i], p.ub[i]);
  }
  for (int r = 0; r < p.rows; ++r) {
    const double* row = p.C + static_cast<long>(r) * n;
    const double activity = dot(row, v, n);
    const double inside = std::min(std::max(activity, p.lo[r]), p.hi[r]);
    primal += (activity - inside) * (activity - inside);
    slack.add(y[r], inside, p.lo[r], p.hi[r]);
    if (y[r] != 0.0) add_scaled(y[r], row, residual, n);
  }
  for (int r = 0; r < p.equalities; ++r) {
    const double* row = p.E + static_cast<long>(r) * n;
    const double misfit = dot(row, v, n) - p.f[r];
    primal += misfit * misfit;
    add_scaled(w[r], row, residual, n);
  }
  const double dual = dot(residual, residual, n) + slack.stray;
  if (!std::isfinite(primal + dual + slack.sum)) {
    return {infinity, infinity, infinity};
  }
  return {std::sqrt(primal), std::sqrt(dual), slack.sum};
}

}  // namespace rmrc
