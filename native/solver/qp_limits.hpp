// What the parts of the solver share: limits, and how they are held.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numbers.hpp"
#include "solver/qp.hpp"

namespace rmrc {

// A limit that the working set implies, but for this share, does not contradict it.
inline constexpr double implied_tolerance = 1e-9;

// Of the multipliers' rates: a smaller one is rounding, and holds nothing up.
inline constexpr double least_rate = 1e-13;

inline double sign_of(Side side) { return side == Side::lower ? -1.0 : 1.0; }

inline bool one_sided(Side side) { return side == Side::lower || side == Side::upper; }

inline bool held(Side side) { return one_sided(side) || side == Side::both; }

inline double relative(double tolerance, double limit) {
  return tolerance * std::max(1.0, std::abs(limit));
}

}  // namespace rmrc
