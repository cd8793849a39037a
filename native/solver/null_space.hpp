// What a matrix maps to zero, as an orthonormal basis.
#pragma once

#include <vector>

namespace rmrc {

/// Householder's QR of Aᵀ with pivots: of the orthonormal columns of Q, those behind the rank span
/// the null space of A. All memory is taken by the constructor.
class NullSpace {
 public:
  /// For matrices of up to `rows` rows and `columns` columns.
  NullSpace(int rows, int columns);

  /// Row r of A, to be written before `find`.
  double* row(int r) { return rows_.data() + r * stride_; }

  /// Find the null space of A (rows, columns); return its dimension, or −1 where it is not clear.
  ///
  /// A singular value below `share` of the largest of 1 and σ_max counts as zero. A pivot is as
  /// large as a singular value but for a small factor: within ten times the threshold nothing is
  /// said. Nor is it of a matrix that is not finite.
  int find(int rows, int columns, double share);

  /// Vector k of the basis (columns,).
  const double* vector(int k) const { return basis_.data() + k * stride_; }

 private:
  void reflect(int by, double* x) const;

  int stride_, columns_ = 0;
  std::vector<double> rows_;   // Aᵀ by columns, then the reflectors
  std::vector<double> basis_;
};

}  // namespace rmrc
