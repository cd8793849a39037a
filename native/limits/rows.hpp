// The rows lo ≤ C v ≤ hi of a step: speeds of frames, and barriers.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "kinematics/mujoco.hpp"
#include "limits/barrier.hpp"
#include "limits/box.hpp"
#include "limits/slides.hpp"
#include "limits/speed.hpp"

namespace rmrc {

/// Where the rows of a step stand, arrays with room for all that there can be.
struct RowArrays {
  double *matrix, *lower, *upper, *multiplier;  // C (capacity, n), lo, hi and y (capacity,)
  std::int64_t* ids;                            // of the entries behind the rows of barriers
  double *distance, *slope, *drift;             // (capacity,), (capacity, nv), (capacity,)
};

/// The rows of one barrier in the present step.
struct Block {
  Barrier* barrier;
  int first, count;  // among all rows
};

/// Gathers the rows of a step: rmrc.qp.rows.Rows, but for the limits of mink's.
class Rows {
 public:
  /// `limits` are those of the joints, and `v_previous` (nv,) the velocity before: both must live as
  /// long.
  Rows(const MuJoCo& mujoco, const Kinematics& now, std::vector<int> dofs, std::vector<int> place,
       const JointLimits& limits, const double* v_previous, const RowArrays& arrays, int capacity);

  /// Take a distance to be on its limit where it is below by no more than `resolution`; `turning`
  /// says which dofs turn, not shift (nv,), and `slides` what levers leave out.
  void know(double resolution, std::vector<bool> turning, Slides slides);

  void add(SpeedRows speed);
  void add(std::unique_ptr<Barrier> barrier);

  /// Return the poses that speeds and barriers read in a step.
  Poses poses() const;

  /// Return those that barriers read where a command leads, at the kinematics there.
  Poses poses_ahead(const Kinematics& there) const;

  /// Write the rows at the present kinematics for a step of dt inside a box lb, ub (n,).
  void update(const double* lb, const double* ub, double dt);

  /// Forget what barriers know of the steps before that is more than where things are.
  void forget();

  /// Go through what there is to keep between two steps.
  void keep(Memory& memory);

  int capacity() const { return capacity_; }
  int count() const { return count_; }

  /// Change the rows, and H (n, n) if it is not null, where v (n,) moves frames too fast; return
  /// whether anything has changed. H then becomes `plain` and the curvature of the speeds.
  bool cut(const double* v, double* H, const double* plain);

  /// By how much v (n,) moves a frame too fast, at most; ≤ 0 if it does not.
  double excess(const double* v) const;

  /// The share of v (n,), from a brake (n,) on, that moves no frame too fast; 0 where the brake does.
  double share_of_speeds(const double* brake, const double* v) const;

  /// How many of the first rows are of speeds.
  int speed_count() const { return speed_count_; }
  const RowArrays& arrays() const { return arrays_; }
  const Kinematics& now() const { return now_; }
  const MuJoCo& mujoco() const { return mujoco_; }
  const std::vector<int>& dofs() const { return dofs_; }
  const JointLimits& limits() const { return *limits_; }

  /// The columns of the dofs (nv,), −1 where one stands still.
  const int* place() const { return place_.data(); }

  /// All barriers, those without a row included.
  const std::vector<Block>& blocks() const { return blocks_; }

  /// The rows of all barriers that bound their distances from above.
  const std::vector<Block>& kept_blocks() const { return kept_blocks_; }

  double resolution() const { return resolution_; }
  const std::vector<bool>& turning() const { return turning_; }
  const Slides& slides() const { return slides_; }

  /// Whether a distance is below its limit.
  bool passed() const { return passed_; }

  /// What each row is known by from step to step, in ascending order (count,).
  const std::int64_t* keys() const { return keys_.data(); }

 private:
  void limit(const double* lb, const double* ub, double dt);
  double lower(const Barrier& barrier, int row, double dt) const;
  double stopping(int row, double room, double dt) const;
  double bounded(int row, double lower) const;
  void add_block(std::int64_t which, double dt);
  void add_kept(std::int64_t which, double dt);
  void add_rows(Block& block, int count, std::int64_t key, double dt);
  Near free();

  MuJoCo mujoco_;
  Kinematics now_;
  std::vector<int> dofs_, place_;
  const JointLimits* limits_;
  const double* v_previous_;
  RowArrays arrays_;
  int capacity_, speed_count_ = 0, room_ = 0;
  double resolution_ = 1e-6;  // rmrc.model.extents.FINEST
  std::vector<bool> turning_;
  Slides slides_;
  std::vector<SpeedRows> speeds_;
  std::vector<std::unique_ptr<Barrier>> barriers_;
  std::vector<Block> blocks_, kept_blocks_;
  int count_ = 0;
  bool passed_ = false;
  std::vector<double> travel_, low_, high_;  // (nv,), (n,)
  std::vector<double> before_, brake_;       // v of the dofs (n,), and what braking leaves of it
  double longest_ = 0.0, most_ = 0.0;        // steps that the joints take to rest, and can take
  std::vector<std::int64_t> keys_;
};

}  // namespace rmrc
