// Frames: where their poses stand, and what moves them.
#pragma once

#include <utility>
#include <vector>

#include "kinematics/mujoco.hpp"

namespace rmrc {

/// A site, body or geom: where MuJoCo writes its pose, and what moves it.
struct Frame {
  const double* position;   // (3,)
  const double* rotation;   // (9,)
  const double* reference;  // (3,): the origin of its tree's root, which cdof and `carrier` refer to
  std::vector<int> dofs;
  const double* carrier = nullptr;  // velocity (6,) of the mocap body that its tree stands on
};

/// What a term is evaluated from: the dofs whose axes make its Jacobian, the poses that it reads, and
/// whether a mocap body carries any of them.
///
/// A term has its columns from here, so that what it reads is known wherever it has a Jacobian.
class Reads {
 public:
  Reads() = default;

  /// Of dofs in the order of the term's columns.
  explicit Reads(std::vector<int> dofs) : dofs_(std::move(dofs)) {}

  /// Add a frame, whose dofs are merged in ascending order.
  Reads& add(const Frame& frame);

  /// Add a pose that is no frame's, and the velocity of what carries it, or null.
  Reads& add(const double* pose, const double* carrier = nullptr);

  /// Add a dof, in ascending order.
  Reads& add(int dof);

  const std::vector<int>& dofs() const { return dofs_; }
  const Poses& poses() const { return poses_; }
  bool carried() const { return carried_; }

 private:
  std::vector<int> dofs_;
  Poses poses_;
  bool carried_ = false;
};

/// out = v + ω × (p − o) (3,), of a twist [v; ω] about o.
void velocity_at(const double* twist, const double* origin, const double* point, double* out);

}  // namespace rmrc
