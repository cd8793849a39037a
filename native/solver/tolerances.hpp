// What more than one part takes for rounding, or for solved.
#pragma once

namespace rmrc {

constexpr double certified = 1e-6;     // rmrc.engine.python.CERTIFIED
constexpr double whole = 1e-6;         // rmrc.qp.cascade.WHOLE
constexpr double inconsistency = 1e-6;  // rmrc.qp.relax.INCONSISTENT

}  // namespace rmrc
