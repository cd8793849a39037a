#include "solver/null_space.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double unclear = 10.0;  // by how much a pivot may miss a singular value

}  // namespace

NullSpace::NullSpace(int rows, int columns)
    : stride_((columns + 3) / 4 * 4),
      rows_(static_cast<std::size_t>(stride_) * rows),
      basis_(static_cast<std::size_t>(stride_) * columns) {}

int NullSpace::find(int rows, int columns, double share) {
  columns_ = columns;
  int rank = 0;
  for (double longest = 1.0; rank < std::min(rows, columns); ++rank) {
    int pivot = rank;
    double square = -1.0;
    for (int r = rank; r < rows; ++r) {
      const double left = dot(row(r) + rank, row(r) + rank, columns - rank);
      if (!std::isfinite(left)) return -1;
      if (left > square) square = left, pivot = r;
    }
    const double length = std::sqrt(square);
    if (rank == 0) longest = std::max(1.0, length);
    if (length * unclear <= share * longest) break;
    if (length < unclear * share * longest) return -1;
    if (pivot != rank) std::swap_ranges(row(pivot), row(pivot) + columns, row(rank));
    // I − 2uuᵀ turns what is left of the row into its first axis; u takes the row's place.
    double* u = row(rank) + rank;
    u[0] += std::copysign(length, u[0]);
    const double inverse = 1.0 / std::sqrt(dot(u, u, columns - rank));
    for (int i = 0; i < columns - rank; ++i) u[i] *= inverse;
    for (int r = rank + 1; r < rows; ++r) reflect(rank, row(r));
  }
  for (int k = 0; k < columns - rank; ++k) {
    double* vector = basis_.data() + k * stride_;
    std::fill_n(vector, columns, 0.0);
    vector[rank + k] = 1.0;
    for (int by = rank - 1; by >= 0; --by) reflect(by, vector);
  }
  return columns - rank;
}

void NullSpace::reflect(int by, double* x) const {
  const double* u = rows_.data() + by * stride_ + by;
  const int count = columns_ - by;
  add_scaled(-2.0 * dot(u, x + by, count), u, x + by, count);
}

}  // namespace rmrc
