// Whether the robot rests without being there: rmrc.control.progress.
#pragma once

#include <vector>

#include "base/memory.hpp"
#include "engine/engine.hpp"

namespace rmrc {

/// A task that is to arrive: its place among the terms with rows, B's diagonal, and the largest
/// distance and angle that count as there, ∞ where one does not matter.
struct Watched {
  int term;
  std::vector<double> weight;
  double tolerance[2];
};

/// Tells whether tasks are not there, and no joint has moved to speak of for a while.
class Progress {
 public:
  /// `tolerance` is that of all tasks together, ‖tolerances‖_B.
  Progress(std::vector<Watched> watched, double tolerance);

  /// Forget what was.
  void reset();

  /// Take note of a command v (n,) at the engine's last evaluation, for a step of dt.
  void update(const Engine& engine, const double* v, double dt);

  /// Go through what there is to keep between two steps.
  void keep(Memory& memory);

  bool stuck() const { return stuck_; }

 private:
  bool off(const Engine& engine) const;
  bool stays(const Engine& engine, const double* v) const;

  std::vector<Watched> watched_;
  double tolerance_;
  bool stuck_ = false;
  double rested_ = 0.0;  // s
};

}  // namespace rmrc
