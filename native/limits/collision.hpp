// The collision barrier: pairs of geoms stay apart, measured only where they may be near.
#pragma once

#include <cstdint>
#include <vector>

#include "kinematics/distance.hpp"
#include "limits/barrier.hpp"

namespace rmrc {

/// The arrays of a rmrc.limits.collision.Collision, which may go on from any step of this
/// one's and the other way round; of pairs (p, …) where nothing else is said.
struct PairArrays {
  int pairs, bodies, mocaps;
  double d_min, detect, gain, push;
  const std::int64_t *geoms, *body, *root, *mocap;  // (p, 2); mocap −1 for what stands on none
  const std::uint8_t *plane, *doubtful;
  const double *size;                               // of the geoms (ngeom, 3)
  const double *radii, *thickness, *levers, *side;  // levers (p, nv + 6 mocaps), side (p, nv)
  const double* longest;                            // the largest of each lever
  const std::int64_t* dof_root;                     // (nv,)
  const double* reach;                              // twice how far a body's geoms reach (bodies,)
  const std::int64_t *base, *other;                 // of the planes between the geoms
  const double *spread, *width, *sign, *carries, *moves;  // carries and moves (p, nv)
  const double* precision;  // the distance that gives no direction, and what blurs a plane (2,)
  const double* twist;                              // of the mocap bodies (mocaps, 6)
  const double* apart;                              // the way that nearest points jump, at least
  // What a step leaves to the next.
  double *bound, *threshold, *distance, *segments, *normals;
  std::uint8_t *active, *measured;
  double *room, *travel;
  double* contacts;                                 // (p, 4, 9)
  std::int64_t* contact_count;                      // (p,)
  double *position, *quaternion, *seen_position, *seen_quaternion;
};

/// A plane between the geoms of a pair, carried by one of them: rmrc's Separation.
struct PairPlane {
  double distance, offset;
  double normal[3], seen[3];
};

/// h = d − d_min of each pair: rmrc.limits.collision.Collision.
class Collision final : public Barrier {
 public:
  Collision(const PairArrays& arrays, const MuJoCo& mujoco);

  void read(const Kinematics& at, bool ahead, Poses& poses) const override;
  void near(const Kinematics& now, const double* travel, double dt, Near& near) override;
  void kept(const Kinematics& now, Near& near) override;
  int most_kept() const override { return most_contacts * a_.pairs; }
  void forget() override;
  double distance(const Kinematics& at, int id) const override;
  double reach(int id, const double* step, double dt) const override;
  double thickness(int id) const override { return a_.thickness[id]; }

  void keep(Memory& memory) override;

  /// Return the plane between an active pair, as it was last given by `near`.
  PairPlane plane(const Kinematics& now, int id) const;

  /// Return what that plane says of h at other kinematics, at least.
  double least(const Kinematics& at, int id, const PairPlane& plane) const;

  /// Return the most by which h falls in a step |Δq| (nv,), and what least h is known accelerates
  /// at most with |q̇| and |q̈| (nv,), for a pair that comes no further apart than by `reach`.
  double fall(int id, const double* step) const;
  double bend(int id, double reach, const double* speed, const double* change) const;

 private:
  static constexpr double leave = 1.2;     // rmrc.limits.collision.LEAVE
  static constexpr int most_contacts = 3;  // rmrc.limits.contacts.KEPT
  static constexpr int contact = 9;        // numbers of one contact, and of those of a pair
  static constexpr int contacts_of_pair = (most_contacts + 1) * contact;

  template <class Action>
  void each_active(Action action) const;
  double bound(const Kinematics& now);
  double most_moved();
  void extend(const double* travel, double dt);
  double grown() const;
  double threshold(int id) const;
  void activate(const Kinematics& now);
  bool is_far(const Kinematics& now, int id, double level);
  double measure(const Kinematics& now, int id);
  void look(const Kinematics& now);
  void release(const Kinematics& now, double motion);
  void direct(const Kinematics& now, int id);
  void write(const Kinematics& now, int id, const double* segment, const double* normal,
             double distance, Near& near) const;
  void differentiate(const Kinematics& now, int id, const double* segment, const double* normal,
                     double* slope) const;
  double drift(const Kinematics& now, int id, const double* segment, const double* normal) const;

  void see_contact(const Kinematics& now, int id);
  void write_contacts(const Kinematics& now, int id, Near& near) const;
  int contact_place(const Kinematics& now, int id) const;
  void contact_segment(const Kinematics& now, int id, const double* points, double* segment) const;
  bool is_same(int id, const double* one, const double* other) const;
  GeomPair pair(int id) const;

  PairArrays a_;
  const PairArrays home_;  // where the arrays are that a step leaves to the next, if not placed
  const MuJoCo& mujoco_;
  int nv_, width_;
  std::vector<double> travel_, moved_;  // (nv + 6 mocaps,), (bodies,)
  std::vector<double> origin_;          // velocity of the point at the world's origin (nv, 3)
};

}  // namespace rmrc
