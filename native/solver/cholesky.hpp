// A Cholesky factor of a part of a matrix, which gains and loses single rows and columns.
#pragma once

#include <vector>

namespace rmrc {

/// L Lᵀ = A, with L lower triangular, its columns contiguous.
///
/// A pivot that rounding has eaten up is replaced by the smallest that A's diagonal can resolve:
/// the factor then belongs to a matrix slightly larger than A, and iterative refinement with A
/// itself takes the difference out.
class Cholesky {
 public:
  /// Allocate for matrices up to capacity × capacity.
  explicit Cholesky(int capacity);

  /// Factorize A = H[index, index], of a symmetric H (n, n) whose rows are `stride` apart.
  void factorize(const double* H, int stride, const int* index, int size);

  /// Append a last row and column to A, `column` (size) and `diagonal`.
  void append(const double* column, double diagonal);

  /// Remove row and column `position` of A.
  void remove(int position);

  /// x ← L⁻¹x, of an x that is 0 before `from`.
  void forward(double* x, int from = 0) const;

  /// x ← L⁻ᵀx.
  void backward(double* x) const;

  int size() const { return size_; }

 private:
  double* column(int j) { return factor_.data() + j * stride_; }
  const double* column(int j) const { return factor_.data() + j * stride_; }

  template <int size>
  void factorize_small(const double* H, int stride, const int* index);
  template <int size>
  void forward_small(double* x) const;
  template <int size>
  void backward_small(double* x) const;

  void subtract_products(int i, int j);
  void factorize_tile(int j);
  void solve_tile(int i, int j);

  /// Return 1/√pivot, of a pivot that is at least what `diagonal` can resolve.
  double inverse_root(double pivot, double diagonal) const;

  int stride_;
  int size_ = 0;
  std::vector<double> factor_;
  std::vector<double> diagonal_;          // of A, as `factorize` has found it
  std::vector<double> inverse_diagonal_;  // 1/Lⱼⱼ: a division costs ten multiplications
  std::vector<double> work_;
};

}  // namespace rmrc
