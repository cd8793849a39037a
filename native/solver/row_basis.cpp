#include "solver/row_basis.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

// Share of a vector outside the basis below which it counts as dependent. Rounding leaves about
// √cond(H)·1e-16; two rows that differ can be as close as 1/√cond(H), where H is near singular.
constexpr double independent_share = 1e-9;

}  // namespace

RowBasis::RowBasis(int capacity)
    : stride_((capacity + 3) / 4 * 4),
      vectors_(static_cast<std::size_t>(stride_) * capacity),
      triangle_(static_cast<std::size_t>(stride_) * capacity),
      work_(capacity) {}

void RowBasis::clear(int size) {
  size_ = size;
  count_ = 0;
}

bool RowBasis::project(double* u, double* c) const {
  const double before = dot(u, u, size_);
  if (count_ == 0) return before > 0.0;
  multiply_transposed(u, c);
  subtract(c, u);
  // Once more: the first pass leaves rounding of the size of u, which may be all there is.
  multiply_transposed(u, work_.data());
  subtract(work_.data(), u);
  for (int t = 0; t < count_; ++t) c[t] += work_[t];
  return count_ < size_ && dot(u, u, size_) > independent_share * independent_share * before;
}

void RowBasis::append(const double* rest, const double* c, double scale) {
  double* own = vectors_.data() + count_ * stride_;
  double* column = triangle_.data() + count_ * stride_;
  const double length = std::sqrt(dot(rest, rest, size_));
  for (int t = 0; t < count_; ++t) column[t] = scale * c[t];
  column[count_] = std::abs(scale) * length;
  const double inverse = (scale < 0.0 ? -1.0 : 1.0) / length;
  for (int i = 0; i < size_; ++i) own[i] = inverse * rest[i];
  ++count_;
}

void RowBasis::solve(double* c) const {
  for (int t = count_ - 1; t >= 0; --t) {
    c[t] /= triangle(t)[t];
    add_scaled(-c[t], triangle(t), c, t);
  }
}

void RowBasis::solve_transposed(double* d) const {
  for (int t = 0; t < count_; ++t) d[t] = (d[t] - dot(triangle(t), d, t)) / triangle(t)[t];
}

void RowBasis::multiply_transposed(const double* u, double* c) const {
  for (int t = 0; t < count_; ++t) c[t] = dot(vector(t), u, size_);
}

void RowBasis::subtract(const double* c, double* u) const {
  for (int t = 0; t < count_; ++t) add_scaled(-c[t], vector(t), u, size_);
}

}  // namespace rmrc
