// The check of a command where it leads, and its shortening where a distance would be passed.
#pragma once

#include <vector>

#include "base/clock.hpp"
#include "base/numbers.hpp"
#include "engine/path.hpp"
#include "kinematics/kinematics.hpp"
#include "limits/collision.hpp"
#include "limits/rows.hpp"
#include "solver/qp.hpp"

namespace rmrc {

/// How much of a command may be carried out.
struct Share {
  double share;  // s of b + s (v − b), with the brake b
  bool passed;   // whether a distance falls below its limit even so
};

/// Keeps distances at the configuration that a command leads to: rmrc.engine.backtracking.Shortening.
class Shortening {
 public:
  /// `own` are the kinematics of data of its own.
  Shortening(const Rows& rows, const Kinematics& own, const double* twist, int mocaps);

  /// Place what the barriers look at by these, in place of MuJoCo's: they must live as long. Throws
  /// std::invalid_argument if barriers read more than that.
  void follow(ForwardKinematics& kinematics);

  /// The rows whose barriers are checked.
  const Rows& rows() const { return rows_; }

  /// Return how much of v (n,) keeps all distances after a step of dt, and on the way to rest
  /// behind it, with the brake (n,); nothing of it where the clock says `end` first.
  Share share(const double* v, const double* brake, double dt,
              Clock::time_point end = Clock::time_point::max());

  /// Go where v (n,) leads in a step of dt, or where it comes to rest, behind a share for the same
  /// step; return how long the way there takes at v, 0 where the joints rest after the step.
  double go_to_end(const double* v, double dt);
  double go_to_rest(const double* v, double dt);

  /// The kinematics there.
  const Kinematics& there() const { return own_; }

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
    double least = infinity;  // of the rooms
    int worst = 0;                                           // the entry that has it
  };

  // A look that found too little room.
  struct Found {
    double place, least;
    Entry entry;
  };

  // What may be passed between a look before and this one.
  struct Part {
    Look look;
    std::vector<int> among;
    int count = 0;
  };

  void watch(const double* v, const double* brake, double dt);
  double guess(const double* v, const double* brake, double high, double dt);
  void blend(const double* v, const double* brake, double share, double dt);
  bool worst(double least);
  bool halved(double least);
  bool is_short(const Look& look, double least);
  int parts();
  void look(double place, const int* among, int count, Look& look);
  int doubtful(const Look& before, const Look& after, const int* among, int count, int* found);
  void put(const double* way);
  void move_obstacles(double dt);

  const Rows& rows_;
  Slides slides_;
  double tolerance_, noise_;  // how far below 0 a distance may be, and may fall by rounding
  MuJoCo mujoco_;
  Kinematics own_;
  ForwardKinematics* kinematics_ = nullptr;
  const double* twist_;
  int mocaps_, n_;
  bool still_ = true;
  std::vector<const Collision*> pairs_;  // of each block, or null

  Path path_;
  Clock::time_point end_;
  double dt_ = 0.0;
  std::vector<double> command_;                            // (n,)
  std::vector<double> step_, fast_, change_, bent_, moved_;  // over all dofs (nv,)

  std::vector<Entry> entries_;
  std::vector<int> all_, some_;
  int count_ = 0;
  Found found_{};
  Look begin_;
  std::vector<Part> ahead_;  // the part that ends last comes first
};

}  // namespace rmrc
