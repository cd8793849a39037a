// What comes in at run time, taken if it is valid: rmrc.control.inputs.
#pragma once

#include <cstdint>

namespace rmrc {

/// A coordinate beyond this is no measurement and no target: rmrc.control.inputs.LARGEST.
inline constexpr double largest_input = 1e12;
/// A quaternion shorter than this has no direction: rmrc.control.inputs.ZERO_NORM.
inline constexpr double zero_norm = 1e-12;

/// Lengths of a step in s beyond which a clock is at fault: rmrc.control.controller.
inline constexpr double shortest_step = 1e-9, longest_step = 1e3;

/// Make a quaternion of a configuration one of length 1; false if it has no direction.
bool normalize(double* turn);

/// A target that is set at run time, a pose, wxyz + xyz, or a point; null for what is not given.
struct Given {
  const double* position;    // (3,)
  const double* quaternion;  // (4,)
  const double* velocity;    // of a pose (6,), of a point (3,)
};

/// Where such a target stands.
struct Aim {
  bool pose;
  double* target;  // (7,) or (3,)
  double* twist;   // (6,)
  std::uint8_t* moving;

  int width() const { return pose ? 6 : 3; }

  /// Set the target, which rests without a velocity; false, and nothing is set, if it is not valid.
  bool take(const Given& given) const;
};

}  // namespace rmrc
