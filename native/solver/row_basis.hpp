// An orthonormal basis of the rows that are active, and the triangle that gives their multipliers.
#pragma once

#include <vector>

namespace rmrc {

/// Q R = [u₀ u₁ …] with QᵀQ = I and R upper triangular, one column at a time.
///
/// Each uₜ is L⁻¹aₜ, an active row in the coordinates in which H is the unit matrix.
class RowBasis {
 public:
  /// Allocate for up to capacity vectors of up to capacity elements.
  explicit RowBasis(int capacity);

  /// Start anew, with vectors of `size` elements.
  void clear(int size);

  /// Split u = Q c + rest: leave the rest in u and write c (count).
  ///
  /// Return whether the rest is more than rounding, that is, u depends on no vectors of the basis.
  bool project(double* u, double* c) const;

  /// Append the vector scale · (Q c + rest), of what `project` has left of it.
  void append(const double* rest, const double* c, double scale);

  /// c ← R⁻¹c.
  void solve(double* c) const;

  /// d ← R⁻ᵀd.
  void solve_transposed(double* d) const;

  /// c = Qᵀu.
  void multiply_transposed(const double* u, double* c) const;

  /// u ← u − Q c.
  void subtract(const double* c, double* u) const;

  int count() const { return count_; }

 private:
  const double* vector(int t) const { return vectors_.data() + t * stride_; }
  const double* triangle(int t) const { return triangle_.data() + t * stride_; }

  int stride_;
  int size_ = 0;
  int count_ = 0;
  std::vector<double> vectors_;   // Q, by columns
  std::vector<double> triangle_;  // R, by columns
  mutable std::vector<double> work_;
};

}  // namespace rmrc
