// Workspace bounds, the origins of frames stay in front of planes, and ranges of ball joints.
#pragma once

#include <vector>

#include "limits/barrier.hpp"

namespace rmrc {

/// What a frame's origin is that of.
enum class Anchor { site, body, geom };

/// A plane that a frame's origin p stays in front of: nᵀp ≥ offset.
struct Plane {
  Anchor anchor;
  int id;                   // of the site, body or geom
  int root;                 // the root of its body's tree
  int mocap;                // the mocap body that this is, or −1
  double normal[3], offset;
  std::vector<int> dofs;    // those that move it
  std::vector<double> levers;  // (nv + 6 nmocap,)
};

/// h = nᵀp − offset: rmrc.limits.workspace.Workspace.
class Workspace final : public Barrier {
 public:
  /// `twist` are the velocities of the mocap bodies (nmocap, 6).
  Workspace(std::vector<Plane> planes, double gain, double push, const double* twist, int nv);

  void read(const Kinematics& at, bool ahead, Poses& poses) const override;
  void near(const Kinematics& now, const double* travel, double dt, Near& near) override;
  double distance(const Kinematics& at, int id) const override;
  double reach(int id, const double* step, double dt) const override;

 private:
  std::vector<Plane> planes_;
  const double* twist_;
  int nv_;
};

/// A ball joint and the largest angle of its rotation.
struct Ball {
  int coordinate, dof;  // the first of four and of three
  double largest;
};

/// h = θ_max − θ of each ball joint: rmrc.limits.ball.BallRange.
class BallRange final : public Barrier {
 public:
  BallRange(std::vector<Ball> balls, double gain, double push, int nv);

  void read(const Kinematics& at, bool ahead, Poses& poses) const override;
  void near(const Kinematics& now, const double* travel, double dt, Near& near) override;
  double distance(const Kinematics& at, int id) const override;
  double reach(int id, const double* step, double dt) const override;

 private:
  std::vector<Ball> balls_;
  int nv_;
};

/// An end of the range of a tendon L = Σ c q: h = sign (L − bound).
struct TendonEnd {
  double sign, bound;
  std::vector<int> coordinates, dofs;
  std::vector<double> coefficients;
};

/// The ends of the ranges of fixed tendons: rmrc.limits.tendon.TendonRange.
class TendonRange final : public Barrier {
 public:
  TendonRange(std::vector<TendonEnd> ends, double gain, double push, int nv);

  void read(const Kinematics& at, bool ahead, Poses& poses) const override;
  void near(const Kinematics& now, const double* travel, double dt, Near& near) override;
  double distance(const Kinematics& at, int id) const override;
  double reach(int id, const double* step, double dt) const override;

 private:
  std::vector<TendonEnd> ends_;
  int nv_;
};

}  // namespace rmrc
