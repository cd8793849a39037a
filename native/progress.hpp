// Whether the tasks still get on: rmrc.control.progress.
#pragma once

#include <vector>

#include "engine.hpp"
#include "memory.hpp"

namespace rmrc {

/// A task that is to arrive: its place among the terms with rows, B's diagonal, and the largest
/// distance and angle that count as there, ∞ where one does not matter.
struct Watched {
  int term;
  std::vector<double> weight;
  double tolerance[2];
};

/// Watches the error ‖e‖_B of the tasks, and beside targets that move the speed at which they come
/// nearer, eᵀB J v / ‖e‖_B.
class Progress {
 public:
  /// `tolerance` is that of all tasks together, ‖tolerances‖_B; `targets` are all the targets.
  Progress(std::vector<Watched> watched, double tolerance, const double* targets, int size);

  /// Forget what was.
  void reset();

  /// Take note of a command v (n,) at the engine's last evaluation, for a step of dt.
  void update(const Engine& engine, const double* v, double dt);

  /// Go through what there is to keep between two steps.
  void keep(Memory& memory);

  bool stuck() const { return stuck_; }

 private:
  void look(const Engine& engine, const double* v, double elapsed);
  void judge(double slowest);
  void begin();

  std::vector<Watched> watched_;
  double tolerance_;
  const double* targets_;
  std::vector<double> last_;  // the targets at the last look
  bool stuck_ = false;
  double since_look_ = 0.0, before_ = 0.0;            // before: the least error of the window before
  double elapsed_ = 0.0, least_ = 0.0, fastest_ = 0.0;  // of the present window
  bool still_ = true, moving_ = true;                 // whether targets never moved; always did
};

}  // namespace rmrc
