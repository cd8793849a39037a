// Forward kinematics of what a step looks at, in place of MuJoCo's of the whole model.
#pragma once

#include <vector>

#include "kinematics/mujoco.hpp"

namespace rmrc {

/// The kinds of joints, by the numbers of MuJoCo's mjtJoint.
enum class JointKind { free, ball, slide, hinge };

struct Joint {
  JointKind kind;
  int coordinate, dof;  // where it begins in q and in v
  double axis[3], position[3];  // in its body
  double zero;                  // the coordinate at which the body is where the model has it

  // What the constructor of ForwardKinematics finds out.
  bool centred = false;  // whether the position is 0
  int along = -1;        // the one of the body's axes that a hinge turns about, if it is one
  bool last = false;     // whether no other joint of the body comes behind
};

struct Body {
  int id, parent;
  int root;   // of its tree
  int mocap;  // the number of the mocap body that this is, or −1
  double position[3], quaternion[4];  // in the parent
  std::vector<Joint> joints;

  // What the constructor of ForwardKinematics finds out.
  bool free = false, shifted = true, turned = true;  // turned or shifted from its parent
};

/// A geom or site, fixed to a body.
struct Attached {
  int id, body;
  bool shifted, turned;  // whether its origin, and its axes, are others than the body's
  double position[3], quaternion[4];
};

/// A body of a subtree whose centre of mass is asked for.
struct Mass {
  int id, parent;  // −1 where nothing above is asked for
  double mass, of_subtree;
  bool shifted;  // whether its centre is another point than its origin
  double centre[3];
};

/// What there is to place: bodies that hold still are left out, and stay where they are.
struct Placed {
  std::vector<Body> bodies;  // a parent before its children
  std::vector<Attached> geoms, sites;
  std::vector<Mass> masses;  // a child before its parent
};

/// Where poses are written: arrays of an mjData, but for the axes.
struct PoseArrays {
  double* qpos;
  const double *mocap_pos, *mocap_quat;
  double *xpos, *xquat, *xmat;
  double *geom_xpos, *geom_xmat, *site_xpos, *site_xmat, *subtree_com;
  double* cdof;  // (nv, 6), of the dofs that move a body: angular, then linear at its root's origin
};

/// Places bodies with what is fixed to them, each number the same as that of mj_kinematics.
///
/// The axes are those of mj_comPos, but at the origin of the root of the tree instead of the centre
/// of its mass, which would take all bodies.
class ForwardKinematics {
 public:
  ForwardKinematics(Placed placed, const PoseArrays& arrays, int nq);

  /// Go to a configuration (nq,), which may be where it is.
  void update(const double* q);

  /// Refuse poses that would be old after `update`: of what moves, and is not placed.
  ///
  /// Throws std::invalid_argument, with what it is that was not registered.
  void require(const Poses& poses, const MovingParts& moving) const;

  /// nq.
  int coordinates() const { return nq_; }

 private:
  void place(const Body& body);
  void hang(const Body& body, double* position, double* quaternion) const;
  void move(const Joint& joint, double* anchor, double* position, double* quaternion);
  void write_axes(const Body& body);
  void attach(const Attached& part, double* position, double* rotation) const;
  void weigh();

  Placed placed_;
  PoseArrays a_;
  int nq_;
  std::vector<double> anchors_;  // of the joints of one body
};

}  // namespace rmrc
