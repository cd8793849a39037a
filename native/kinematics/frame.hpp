// Frames: where their poses stand, and what moves them.
#pragma once

#include <vector>

namespace rmrc {

/// A site, body or geom: where MuJoCo writes its pose, and what moves it.
struct Frame {
  const double* position;   // (3,)
  const double* rotation;   // (9,)
  const double* reference;  // (3,): the origin of its tree's root, which cdof and `carrier` refer to
  std::vector<int> dofs;
  const double* carrier = nullptr;  // velocity (6,) of the mocap body that its tree stands on
};

/// out = v + ω × (p − o) (3,), of a twist [v; ω] about o.
void velocity_at(const double* twist, const double* origin, const double* point, double* out);

}  // namespace rmrc
