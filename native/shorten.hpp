// The check of a command where it leads: rmrc.control.shorten, as far as nothing is passed there.
#pragma once

#include <vector>

#include "collision.hpp"
#include "kinematics.hpp"
#include "rows.hpp"

namespace rmrc {

/// Says whether a command may be carried out as it is; how far it may be is Python's to find out.
class Shortening {
 public:
  /// `own` are the kinematics of data of its own; `deceleration` (n,) is a_max, ∞ without a limit.
  Shortening(const Rows& rows, const Kinematics& own, std::vector<double> deceleration,
             const double* twist, int mocaps);

  /// Place what the barriers look at by these, in place of MuJoCo's: they must live as long.
  void follow(ForwardKinematics& kinematics) { kinematics_ = &kinematics; }

  /// Whether v (n,) keeps all distances after a step of dt, and on the way to rest behind it, for
  /// all that is known without doubt.
  bool free(const double* v, double dt);

 private:
  // An entry of a barrier that the motion could carry below what is allowed.
  struct Entry {
    const Barrier* barrier;
    const Collision* pairs;  // the barrier, if it is of pairs
    int id;
    double floor, now, reach;
    PairPlane plane;
  };

  // What a look at one place gave: of each entry its room above what is allowed, and what is known
  // of that without measuring.
  struct Look {
    double place = 0.0;
    std::vector<double> way, room, known;
  };

  // What may be passed between a look before and this one.
  struct Part {
    Look look;
    std::vector<int> among;
    int count = 0;
  };

  void set_out(const double* v, double dt);
  bool watch();
  void add(const Block& block, int row, double reach);
  bool worst();
  bool halved();
  int parts();
  bool look(double place, const int* among, int count, Look& look);
  int doubtful(const Look& before, const Look& after, const int* among, int count, int* found);
  void way(double place, double* way) const;
  void put(const double* way);
  void move_obstacles(double dt);

  const Rows& rows_;
  MuJoCo mujoco_;
  Kinematics own_;
  ForwardKinematics* kinematics_ = nullptr;
  const double* twist_;
  int mocaps_, n_;
  std::vector<double> deceleration_;
  bool slows_, still_ = true;
  std::vector<const Collision*> pairs_;  // of each block, or null

  // The path: of each joint its sign and speed, the whole steps it takes to rest, and the change.
  double dt_ = 0.0, last_ = 1.0;
  std::vector<double> sign_, speed_, steps_, change_;
  std::vector<double> step_, fast_, turn_, bent_, moved_;  // over all dofs (nv,)

  std::vector<Entry> entries_;
  std::vector<int> all_, some_;
  int count_ = 0;
  Look begin_;
  std::vector<Part> ahead_;  // the part that ends last comes first
};

}  // namespace rmrc
