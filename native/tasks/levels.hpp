// What the levels of a problem ask for at the present evaluation: rmrc.qp.assemble.Assembly.levels.
#pragma once

#include <memory>
#include <vector>

#include "solver/cascade.hpp"
#include "tasks/row_term.hpp"

namespace rmrc {

/// The tasks of one level.
struct LevelTasks {
  /// A term by its place among those with rows; of one that moves along its ẋ, the rows that weigh.
  struct Part {
    int term;
    std::vector<int> directed;
  };

  /// A term on the joints themselves: S (rows, nv), of the rows that are not zero.
  struct JointPart {
    int first;
    std::vector<double> root;
  };

  std::vector<Part> parts;
  std::vector<JointPart> joints;
  bool hard = false;  // whether it is of the hard tasks that bend, a level where they are a cost
};

/// What picks among equal motions: A in the program's unit, and its share of M(q).
struct LastMetric {
  std::vector<double> constant;  // (n, n)
  double inertia;
};

/// How the tasks that no cost draws are taken in a step.
struct Manner {
  bool directed;  // whether what preserves its direction does; it is a cost like any other if not
  bool softened;  // whether hard tasks that bend are a level before the others
  double dt, least;  // what X of theirs takes: the step's length, s, and the least dt K
};

/// Gathers the levels, the highest first; last comes A, or the least norm.
class Levels {
 public:
  Levels(std::vector<LevelTasks> tasks, LastMetric metric, std::vector<int> dofs, int nv,
         const std::vector<std::unique_ptr<RowTerm>>& terms);

  /// Find X of each level at ẋ of all terms for a step of dt, with dt K at least `least`.
  void curve(const std::vector<std::unique_ptr<RowTerm>>& terms, const double* rate, double dt,
             double least);

  /// Gather them for ẋ of all terms, M(q) (nv, nv), and λ² in the program's unit.
  const std::vector<Level>& gather(const std::vector<std::unique_ptr<RowTerm>>& terms,
                                   const Stack& stack, const double* rate, const double* inertia,
                                   double damping, const Manner& manner);

  /// The tasks of the levels that `gather` returns, but for the last.
  const std::vector<LevelTasks>& tasks() const { return tasks_; }

  const LevelSizes& sizes() const { return sizes_; }

 private:
  void gather(const LevelTasks& tasks, const std::vector<std::unique_ptr<RowTerm>>& terms,
              const Stack& stack, const double* rate, Level& level);
  void bound_exact(std::size_t k, const std::vector<std::unique_ptr<RowTerm>>& terms,
                   const double* rate, const Manner& manner);
  void write_metric(const double* inertia, double damping);

  std::vector<LevelTasks> tasks_;
  LastMetric metric_;
  std::vector<int> dofs_;
  int nv_;
  LevelSizes sizes_{};
  std::vector<double> matrix_, rate_;         // W and S ẋ of all levels
  std::vector<double> jacobian_, direction_;  // J and ẋ of what keeps its direction
  std::vector<double> curvature_;             // X of all levels
  std::vector<const double*> curved_;         // where a level's stands, null where it has none
  std::vector<double> exact_curvature_;       // with that of the tasks that no cost draws
  std::vector<int> directed_;                 // of each level the rows that preserve directions
  std::vector<double> last_;                  // the metric of the last level (n, n)
  std::vector<Level> levels_;
};

}  // namespace rmrc
