// What a step takes from MuJoCo: functions of the loaded library, and arrays where Python says.
//
// No struct of MuJoCo's is known here, so that one build serves every version whose functions have
// these signatures.
#pragma once

#include <memory>
#include <vector>

namespace rmrc {

/// The functions of libmujoco that a step calls; mjModel and mjData are opaque.
struct MuJoCoFunctions {
  void (*kinematics)(const void* model, void* data);
  void (*com_pos)(const void* model, void* data);
  void (*make_inertia)(const void* model, void* data);
  void (*full_inertia)(const void* model, const void* data, double* matrix);
  void (*integrate_pos)(const void* model, double* q, const double* v, double dt);
  void (*differentiate_pos)(const void* model, double* v, double dt, const double* from,
                            const double* to);
  double (*geom_distance)(const void* model, const void* data, int first, int second, double most,
                          double* segment);
};

/// Which bodies, geoms and sites of a model anything moves.
struct MovingParts {
  std::vector<char> bodies, geoms, sites;
};

/// Addresses of poses in the arrays of an mjData.
using Poses = std::vector<const double*>;

/// A model with its data, and the arrays of theirs that a step reads.
struct MuJoCo {
  MuJoCoFunctions call;
  const void* model;
  void* data;
  int nq, nv;
  double* qpos;        // (nq,)
  const double* cdof;  // (nv, 6): the axis of each dof, angular then linear, at its root's origin
  std::shared_ptr<const MovingParts> moving = nullptr;  // needed where not all poses are MuJoCo's
};

/// Any data of the model, and the arrays of its that barriers read.
struct Kinematics {
  void* data;
  double *qpos, *mocap_pos, *mocap_quat;
  const double *xpos, *xquat;           // of the bodies (nbody, 3) and (nbody, 4)
  double* geom_xpos;                    // (ngeom, 3), which a distance moves to and fro
  const double* geom_xmat;              // (ngeom, 9)
  const double* site_xpos;              // (nsite, 3)
  const double *cdof, *reference;       // (nv, 6), and the point of each root that they refer to
};

}  // namespace rmrc
