#include "kinematics/frame.hpp"

#include "base/lie.hpp"

namespace rmrc {

void velocity_at(const double* twist, const double* origin, const double* point, double* out) {
  double arm[3];
  for (int i = 0; i < 3; ++i) arm[i] = point[i] - origin[i];
  cross(twist + 3, arm, out);
  for (int i = 0; i < 3; ++i) out[i] += twist[i];
}

}  // namespace rmrc
