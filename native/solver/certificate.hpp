// The residuals of the optimality conditions, of a solution.
#pragma once

#include "solver/qp.hpp"

namespace rmrc {

/// Residuals as in rmrc.qp.program.KKT: 0 at the optimum, ∞ where a number is not finite.
struct Residuals {
  double primal, dual, complementarity;
};

/// Clip v (n,) into the box, in place, and return its residuals as rmrc.qp.certificate does.
///
/// z (n,), y (rows,) and w (equalities,) are the multipliers of the bounds, the rows and the
/// equalities; `residual` (n,) is overwritten with H v + g + z + Cᵀy + Eᵀw. `gradient` is H v + g, if
/// it is known of this v, which must then be that of H itself; it is not looked at where v is clipped.
Residuals certify(int n, const Program& program, const double* z, const double* y, const double* w,
                  double* v, double* residual, const double* gradient = nullptr);

}  // namespace rmrc
