#include "kinematics/distance.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "base/lie.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.model.distance: PARALLEL, ASIDE and AGAIN.
constexpr double parallel = 1e-9;
constexpr double aside = 1e-10;
constexpr int again = 6;

// By how much a segment overlaps a box, along which axis, and where on the segment.
struct Pierced {
  double overlap, axis[3], along;
};

// None where the segment c + t u, |t| ≤ half, does not overlap the box. The overlap is least along a
// normal of the box's faces, or across the segment and an edge.
std::optional<Pierced> pierced(const double* c, const double* u, const double* box, double half) {
  Pierced found{infinity, {0.0, 0.0, 0.0}, 0.0};
  auto& [least, axis, along] = found;
  int edge = -1;
  for (int i = 0; i < 3; ++i) {
    const double overlap = box[i] + half * std::abs(u[i]) - std::abs(c[i]);
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
    const double across = box[j] * std::abs(u[k]) + box[k] * std::abs(u[j]);
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
  along = std::copysign(half, dot3(u, axis));
  if (edge >= 0) {
    const int j = (edge + 1) % 3, k = (edge + 2) % 3;
    double gap = 0.0;
    for (const int m : {j, k}) gap += (-std::copysign(box[m], axis[m]) - c[m]) * u[m];
    along = gap / (u[j] * u[j] + u[k] * u[k]);
  }
  return found;
}

// Where on the segment c + t u, |t| ≤ half, the distance from a box is least. The slope of half its
// square grows with t, in a straight line between where a coordinate enters or leaves the box.
double nearest(const double* c, const double* u, const double* box, double half) {
  const auto slope = [&](double t) {
    double way = 0.0;
    for (int i = 0; i < 3; ++i) {
      const double at = c[i] + t * u[i];
      way += u[i] * (at - std::min(std::max(at, -box[i]), box[i]));
    }
    return way;
  };
  double low = -half, high = half, slope_low = slope(low), slope_high = slope(high);
  if (slope_low >= 0.0) return low;
  if (slope_high <= 0.0) return high;
  for (int i = 0; i < 3; ++i) {
    for (const double end : {-box[i], box[i]}) {
      const double t = u[i] != 0.0 ? (end - c[i]) / u[i] : low;
      if (!(low < t && t < high)) continue;
      const double at = slope(t);
      (at < 0.0 ? low : high) = t;
      (at < 0.0 ? slope_low : slope_high) = at;
    }
  }
  return low + (high - low) * (slope_low / (slope_low - slope_high));
}

// The distance of a capsule and a box, and their nearest points.
double capsule_and_box(const Kinematics& at, const GeomPair& pair, double* segment) {
  const double *turn = at.geom_xmat + 9 * pair.second, *xmat = at.geom_xmat + 9 * pair.first;
  const double* place = at.geom_xpos + 3 * pair.first;
  const double turned[3] = {xmat[2], xmat[5], xmat[8]};
  double apart[3], c[3], u[3];  // centre and direction of the capsule, in the box's axes
  for (int i = 0; i < 3; ++i) apart[i] = place[i] - at.geom_xpos[3 * pair.second + i];
  rotate_back(turn, apart, c);
  rotate_back(turn, turned, u);
  double axis[3], along, d;
  if (const auto found = pierced(c, u, pair.box, pair.half)) {
    std::copy_n(found->axis, 3, axis);
    along = found->along;
    d = -(found->overlap + pair.radius);
  } else {
    along = nearest(c, u, pair.box, pair.half);
    for (int i = 0; i < 3; ++i) {
      const double x = c[i] + along * u[i];
      axis[i] = std::min(std::max(x, -pair.box[i]), pair.box[i]) - x;
    }
    const double gap = norm3(axis);
    for (double& component : axis) component /= gap != 0.0 ? gap : 1.0;
    d = gap - pair.radius;
  }
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
  if (pair.ours) return std::min(capsule_and_box(at, pair, segment), most);
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
