// What a singularity or a large error adds to the damping: rmrc.qp.damping.
#pragma once

#include <memory>
#include <vector>

#include "solver/singular_values.hpp"
#include "tasks/row_term.hpp"

namespace rmrc {

/// What raises λ above its floor.
enum class Adapt { off, sigma_min, manipulability, error };

/// How the damping adapts, as in rmrc.qp.damping.Damping.
struct DampingRule {
  Adapt adapt;
  double threshold, largest;
  int rank;      // that W has at almost every configuration
  double scale;  // what turns W into the configuration's own unit
};

/// A row of W that counts: of a term, by its place among those with rows.
struct TaskedRow {
  int term, row;
};

/// Computes λ_a² over the tasked rows.
class Damping {
 public:
  Damping(DampingRule rule, std::vector<TaskedRow> rows, int size);

  /// Return λ_a² at the present W and errors of the terms.
  double square(const std::vector<std::unique_ptr<RowTerm>>& terms, const double* error);

  bool adapts() const { return rule_.adapt != Adapt::off && rule_.rank > 0; }

 private:
  void gather(const std::vector<std::unique_ptr<RowTerm>>& terms);
  double by_sigma_min();
  double by_manipulability();
  double error_square(const std::vector<std::unique_ptr<RowTerm>>& terms,
                      const double* error) const;

  DampingRule rule_;
  std::vector<TaskedRow> rows_;
  int size_, count_, length_;  // dofs, and vectors and their length, of W or of Wᵀ
  bool transposed_;
  std::vector<double> weighted_, row_;
  SingularValues values_;
  // A matrix, and what its σ_r is at least: σ_r of another is less by no more than their distance.
  std::vector<double> reference_;
  double bound_ = 0.0;
};

}  // namespace rmrc
