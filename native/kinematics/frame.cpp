#include "kinematics/frame.hpp"

#include <algorithm>

#include "base/lie.hpp"

namespace rmrc {

Reads& Reads::add(const Frame& frame) {
  for (const int dof : frame.dofs) add(dof);
  for (const double* pose : {frame.position, frame.rotation, frame.reference}) add(pose);
  carried_ |= frame.carrier != nullptr;
  return *this;
}

Reads& Reads::add(const double* pose, const double* carrier) {
  poses_.push_back(pose);
  carried_ |= carrier != nullptr;
  return *this;
}

Reads& Reads::add(int dof) {
  const auto at = std::lower_bound(dofs_.begin(), dofs_.end(), dof);
  if (at == dofs_.end() || *at != dof) dofs_.insert(at, dof);
  return *this;
}

void velocity_at(const double* twist, const double* origin, const double* point, double* out) {
  double arm[3];
  for (int i = 0; i < 3; ++i) arm[i] = point[i] - origin[i];
  cross(twist + 3, arm, out);
  for (int i = 0; i < 3; ++i) out[i] += twist[i];
}

}  // namespace rmrc
