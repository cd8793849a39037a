// The signed distance of two geoms: MuJoCo's, and our own where MuJoCo's is wrong.
#pragma once

#include "kinematics/mujoco.hpp"

namespace rmrc {

/// A pair of geoms, ordered by type.
struct GeomPair {
  int first, second;
  bool ours;      // a capsule and a box: MuJoCo's distance of them is not always right
  double box[3];  // half the box's sides
  double radius, half;  // the capsule's
};

/// Return the distance as rmrc.model.distance.signed_distance does, at most `most`.
///
/// `segment` (6,) gets the nearest points of the first and of the second geom.
double signed_distance(const MuJoCo& mujoco, const Kinematics& at, const GeomPair& pair,
                       double most, double* segment);

}  // namespace rmrc
