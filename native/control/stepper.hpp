// A controller's step where nothing rare happens: rmrc.control.controller, its common path.
#pragma once

#include <cstdint>
#include <vector>

#include "base/memory.hpp"
#include "control/progress.hpp"
#include "engine/engine.hpp"

namespace rmrc {

/// What a step starts from, and leaves behind: arrays of the controller's.
struct ControllerState {
  double* q;           // (nq,): where the last command led to
  double* v;           // (nv,): the last command
  double* v_previous;  // (nv,): what the terms count from
};

/// An array that a step keeps a copy of, and how long it is.
struct KeptArray {
  const double* values;
  int size;
};

/// Which targets move.
struct KeptFlags {
  const std::uint8_t* values;
  int size;
};

/// What a step has to say beside its numbers.
struct Summary {
  unsigned flags;  // bit k for the status of value k, as in rmrc.control.status.Status
  SolveStatus ending;
  int iterations;
};

/// Where v begins among a step's numbers, and the configuration that it leads to behind it.
inline constexpr int v_begins = 5;

/// Takes steps from q as measured or commanded, and keeps what they were computed from.
class Stepper {
 public:
  /// `quaternions` are addresses in q; `frozen` (n,) tells which dofs stand still by a task.
  Stepper(Engine& engine, Progress progress, ControllerState state, std::vector<int> quaternions,
          std::vector<char> frozen, double budget, std::vector<KeptArray> kept,
          KeptFlags moving);

  /// Take a step of dt seconds from q (nq,), or from where the last one led to if q is null.
  ///
  /// Return false, and change nothing, if q is not valid.
  bool step(const double* q, double dt, Summary& summary);

  /// Doubles that the last step is written to: residuals (3), dt, the share, v, the configuration v
  /// leads to,
  /// the one it starts from, v_previous, z, the arrays kept, and 1 for each target that moves; then
  /// the number of rows of each barrier, and the ids, lo, hi and y of all rows; then w.
  int size() const;

  /// Write the last step.
  void write(double* out) const;

  /// Slow down for dt seconds at the limits of the acceleration, or stand still at once.
  void brake(double dt);

  /// Start anew at q (nq,) that moves with v (nv,).
  void reset(const double* q, const double* v);

  /// Go through what there is to keep between two steps.
  void keep(Memory& memory);

  /// Where the last step has led to.
  const ControllerState& state() const { return state_; }

  Engine& engine() { return engine_; }
  const MuJoCo& mujoco() const { return engine_.mujoco(); }
  Progress& progress() { return progress_; }

 private:
  bool read(const double* q);
  bool is_elsewhere(double dt) const;
  void carry_out(double dt);
  unsigned flags(SolveStatus ending) const;

  Engine& engine_;
  Progress progress_;
  ControllerState state_;
  std::vector<int> quaternions_;
  std::vector<char> frozen_;
  double budget_;
  std::vector<KeptArray> kept_;
  KeptFlags moving_;
  int size_;  // without the rows
  std::vector<double> from_;                    // (nq,)
  std::vector<double> before_, left_;  // v before and after a brake (n,)
  double dt_ = 0.0;
};

}  // namespace rmrc
