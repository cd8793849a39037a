// Whether the tasks still get on: rmrc.control.progress.
#pragma once

#include <vector>

#include "engine.hpp"

namespace rmrc {

/// A task that is to arrive: its place among the terms with rows, B's diagonal, and the largest
/// distance and angle that count as there, ∞ where one does not matter.
struct Watched {
  int term;
  std::vector<double> weight;
  double tolerance[2];
};

/// Watches the speed p = eᵀB J v / ‖e‖_B at which the tasks approach their targets.
class Progress {
 public:
  /// `tolerance` is that of all tasks together, ‖tolerances‖_B.
  Progress(std::vector<Watched> watched, double tolerance);

  /// Forget what was.
  void reset();

  /// Take note of the engine's last command, for a step of dt.
  void update(const Engine& engine, double dt);

  bool stuck() const { return stuck_; }

 private:
  bool stands(const Engine& engine) const;

  std::vector<Watched> watched_;
  double tolerance_;
  double since_look_ = 0.0, without_ = 0.0;
  bool stuck_ = false;
};

}  // namespace rmrc
