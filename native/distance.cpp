#include "distance.hpp"

#include <cmath>
#include <limits>
#include <optional>

#include "lie.hpp"

namespace rmrc {

namespace {

// rmrc.problem.limits.distance: PARALLEL, ASIDE and AGAIN.
constexpr double parallel = 1e-9;
constexpr double aside = 1e-10;
constexpr int again = 6;

// The distance of a capsule whose axis passes through a box; none of any other. The overlap of a
// segment and a box is least along a normal of its faces, or across the segment and an edge.
std::optional<double> pierced_distance(const Kinematics& at, const GeomPair& pair,
                                       double* segment) {
  const double *turn = at.geom_xmat + 9 * pair.second, *xmat = at.geom_xmat + 9 * pair.first;
  const double* place = at.geom_xpos + 3 * pair.first;
  const double turned[3] = {xmat[2], xmat[5], xmat[8]};
  double apart[3], c[3], u[3];  // centre and direction of the capsule, in the box's axes
  for (int i = 0; i < 3; ++i) apart[i] = place[i] - at.geom_xpos[3 * pair.second + i];
  rotate_back(turn, apart, c);
  rotate_back(turn, turned, u);
  double least = std::numeric_limits<double>::infinity(), axis[3] = {0.0, 0.0, 0.0};
  int edge = -1;
  for (int i = 0; i < 3; ++i) {
    const double overlap = pair.box[i] + pair.half * std::abs(u[i]) - std::abs(c[i]);
    if (!(overlap > 0.0)) return std::nullopt;
    if (overlap >= least) continue;
    least = overlap;
    for (double& component : axis) component = 0.0;
    axis[i] = -std::copysign(1.0, c[i]);
  }
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const double sine = std::sqrt(u[j] * u[j] + u[k] * u[k]);
    if (sine < parallel) continue;
    const double offset = (c[k] * u[j] - c[j] * u[k]) / sine;
    const double across = pair.box[j] * std::abs(u[k]) + pair.box[k] * std::abs(u[j]);
    const double overlap = across / sine - std::abs(offset);
    if (!(overlap > 0.0)) return std::nullopt;
    if (overlap >= least) continue;
    least = overlap;
    edge = i;
    const double away = -std::copysign(1.0, offset);
    axis[i] = 0.0;
    axis[j] = -away * u[k] / sine;
    axis[k] = away * u[j] / sine;
  }
  // Where on the capsule's axis the contact is: at its end, or abreast of the box's edge.
  double along = std::copysign(pair.half, dot3(u, axis));
  if (edge >= 0) {
    const int j = (edge + 1) % 3, k = (edge + 2) % 3;
    double gap = 0.0;
    for (const int m : {j, k}) gap += (-std::copysign(pair.box[m], axis[m]) - c[m]) * u[m];
    along = gap / (u[j] * u[j] + u[k] * u[k]);
  }
  const double d = -(least + pair.radius);
  double normal[3];
  rotate(turn, axis, normal);
  for (int i = 0; i < 3; ++i) {
    segment[i] = place[i] + along * turned[i] + pair.radius * normal[i];
    segment[3 + i] = segment[i] + d * normal[i];
  }
  return d;
}

}  // namespace

double signed_distance(const MuJoCo& mujoco, const Kinematics& at, const GeomPair& pair,
                       double most, double* segment) {
  if (pair.doubtful) {
    if (const auto d = pierced_distance(at, pair, segment)) return *d;
  }
  const auto measure = [&] {
    return mujoco.call.geom_distance(mujoco.model, at.data, pair.first, pair.second, most, segment);
  };
  double d = measure();
  // MuJoCo before 4.0 says 0 of hulls that are apart.
  for (int k = 0; k < again && d == 0.0; ++k) {
    double& coordinate = at.geom_xpos[3 * pair.second + k % 3];
    const double place = coordinate;
    coordinate += k % 2 == 0 ? aside : -aside;
    d = measure();
    coordinate = place;
  }
  return d;
}

}  // namespace rmrc
