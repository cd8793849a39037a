#include "solver/row_reduction.hpp"

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

constexpr int sweeps = 30;
// Largest cosine of two rows that are orthogonal but for rounding.
constexpr double orthogonal = 4.0 * epsilon;

}  // namespace

RowReduction::RowReduction(int capacity, int most, int more)
    : more_(more),
      stride_((most + more + 3) / 4 * 4),
      rows_(static_cast<std::size_t>(stride_) * capacity),
      squares_(capacity) {}

int RowReduction::reduce(int count, int size, double share) {
  const int width = size + more_;
  double all = 0.0;
  for (int i = 0; i < count; ++i) all += squares_[i] = dot(row(i), row(i), size);
  if (!std::isfinite(all)) return count;
  const double nothing = epsilon * epsilon * all;  // a row that rounding is all there is of
  bool turned = true;
  for (int sweep = 0; turned && sweep < sweeps; ++sweep) {
    turned = false;
    for (int i = 0; i < count; ++i) {
      for (int j = i + 1; j < count; ++j) {
        const double aa = squares_[i], bb = squares_[j];
        if (aa <= nothing || bb <= nothing) continue;
        double *a = row(i), *b = row(j);
        const double ab = dot(a, b, size);
        if (!(std::abs(ab) > orthogonal * std::sqrt(aa * bb))) continue;
        turned = true;
        const double ratio = (bb - aa) / (2.0 * ab);
        const double t = std::copysign(1.0, ratio) / (std::abs(ratio) + std::hypot(1.0, ratio));
        const double c = 1.0 / std::sqrt(1.0 + t * t), s = c * t;
        for (int k = 0; k < width; ++k) {
          const double x = a[k], y = b[k];
          a[k] = c * x - s * y;
          b[k] = s * x + c * y;
        }
        squares_[i] = dot(a, a, size);
        squares_[j] = dot(b, b, size);
      }
    }
  }
  double longest = 1.0;
  for (int i = 0; i < count; ++i) longest = std::max(longest, std::sqrt(squares_[i]));
  int kept = 0;
  for (int i = 0; i < count; ++i) {
    if (!(std::sqrt(squares_[i]) > share * longest)) continue;
    if (i != kept) {
      std::swap_ranges(row(i), row(i) + width, row(kept));
      std::swap(squares_[i], squares_[kept]);
    }
    ++kept;
  }
  return kept;
}

}  // namespace rmrc
