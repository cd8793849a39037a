// The residuals of the optimality conditions, of a solution inside a box.
#pragma once

namespace rmrc {

/// Residuals as in rmrc.qp.program.KKT: 0 at the optimum, ∞ where a number is not finite.
struct Residuals {
  double primal, dual, complementarity;
};

/// Clip v (n,) into the box, in place, and return its residuals as rmrc.qp.certificate does.
///
/// `residual` (n,) is overwritten with H v + g + z.
Residuals certify(int n, const double* H, const double* g, const double* lb, const double* ub,
                  const double* z, double* v, double* residual);

}  // namespace rmrc
