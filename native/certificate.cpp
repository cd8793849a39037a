#include "certificate.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels.hpp"

namespace rmrc {

Residuals certify(int n, const double* H, const double* g, const double* lb, const double* ub,
                  const double* z, double* v, double* residual) {
  double primal = 0.0, complementarity = 0.0, stray = 0.0;
  for (int i = 0; i < n; ++i) {
    const double inside = std::min(std::max(v[i], lb[i]), ub[i]);
    primal += (v[i] - inside) * (v[i] - inside);
    v[i] = inside;
  }
  for (int i = 0; i < n; ++i) residual[i] = dot(H + i * n, v, n) + g[i] + z[i];
  for (int i = 0; i < n; ++i) {
    if (z[i] == 0.0) continue;
    const double distance = z[i] > 0.0 ? ub[i] - v[i] : v[i] - lb[i];
    if (std::isinf(distance)) {
      stray += z[i] * z[i];
    } else {
      complementarity += std::abs(z[i]) * distance;
    }
  }
  const double dual = dot(residual, residual, n) + stray;
  if (!std::isfinite(primal + dual + complementarity)) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    return {infinity, infinity, infinity};
  }
  return {std::sqrt(primal), std::sqrt(dual), complementarity};
}

}  // namespace rmrc
