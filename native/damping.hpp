// What a singularity or a large error adds to the damping: rmrc.qp.damping.
#pragma once

#include <vector>

#include "tasks.hpp"

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
  void find_singular_values(const std::vector<std::unique_ptr<RowTerm>>& terms);
  double error_square(const std::vector<std::unique_ptr<RowTerm>>& terms,
                      const double* error) const;

  DampingRule rule_;
  std::vector<TaskedRow> rows_;
  int count_, length_, stride_;  // vectors that are made orthogonal, and their length
  bool transposed_;
  std::vector<double> vectors_, row_;
  std::vector<double> sigma_;
};

}  // namespace rmrc
