// Rows that depend on one another, as independent ones: by the singular value decomposition.
#pragma once

#include <vector>

namespace rmrc {

/// Rotates rows [J | X] among each other until those of J are orthogonal: with J = U Σ Vᵀ they are
/// then Uᵀ[J | X], and the lengths of the first part are the singular values.
///
/// One-sided Jacobi rotations. All memory is taken by the constructor.
class RowReduction {
 public:
  /// Up to `capacity` rows, of up to `most` elements in J and `more` in X behind them.
  RowReduction(int capacity, int most, int more);

  /// Row r, to be written before `reduce`.
  double* row(int r) { return rows_.data() + r * stride_; }
  const double* row(int r) const { return rows_.data() + r * stride_; }

  /// Rotate `count` rows with `size` elements in J, and bring those to the front that are longer
  /// than `share` of the largest of 1 and the longest; return their number. Of what is not finite
  /// all stay as they are.
  int reduce(int count, int size, double share);

 private:
  int more_, stride_;
  std::vector<double> rows_;
  std::vector<double> squares_;
};

}  // namespace rmrc
