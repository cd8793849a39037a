// The singular values of a matrix.
#pragma once

#include <vector>

namespace rmrc {

/// Finds single singular values σ₁ ≥ σ₂ ≥ … of `count` vectors of at least as many elements.
///
/// Reflections of Householder's make the matrix bidiagonal, B. How many eigenvalues of BᵀB are below
/// a number is how many pivots of BᵀB − x are negative (Sylvester), of the differential form of the
/// qd algorithm, which is as exact as B; the interval of σ² is narrowed by such counts, many at
/// once. The error is that of a decomposition, some ε σ₁.
///
/// Source: Golub and Kahan 1965; Fernando 1998, *Accurately counting singular values of bidiagonal
/// matrices and eigenvalues of skew-symmetric tridiagonal matrices*.
class SingularValues {
 public:
  SingularValues(int count, int length);

  /// Take a matrix over (count × length, vector by vector).
  void decompose(const double* matrix);

  /// Whether σ² of the place r = 1 … count is at least this large.
  bool at_least(int place, double square) const;

  /// Return σ² of a place, which lies between low and high, from below by at most
  /// `absolute` + `relative` σ².
  double square(int place, double low, double high, double absolute, double relative) const;

  /// Return Σ σ², which none of them exceeds.
  double sum_of_squares() const;

  /// Return the product of all.
  double product() const;

 private:
  void reflect_row(int i);
  void reflect_column(int i);
  void count_below(const double* points, int* below) const;

  int count_, length_;
  std::vector<double> vectors_;               // the matrix, and then B and the reflections
  std::vector<double> along_, dots_;          // of the vectors that a reflection turns
  std::vector<double> diagonal_, beside_;     // σ of B are those of the matrix
  std::vector<double> squares_, beside_squares_;
};

}  // namespace rmrc
