#include "damping.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

#include "kernels.hpp"

namespace rmrc {

namespace {

constexpr int sweeps = 30;
// Largest cosine of two vectors that are orthogonal but for rounding.
constexpr double orthogonal = 4.0 * std::numeric_limits<double>::epsilon();

}  // namespace

Damping::Damping(DampingRule rule, std::vector<TaskedRow> rows, int size)
    : rule_(rule),
      rows_(std::move(rows)),
      count_(std::min(static_cast<int>(rows_.size()), size)),
      length_(std::max(static_cast<int>(rows_.size()), size)),
      stride_(length_),
      transposed_(static_cast<int>(rows_.size()) > size),
      vectors_(static_cast<std::size_t>(count_) * stride_),
      row_(size),
      sigma_(count_) {}

double Damping::square(const std::vector<std::unique_ptr<RowTerm>>& terms, const double* error) {
  const double most = rule_.largest * rule_.largest;
  if (rule_.adapt == Adapt::error) return std::min(0.5 * error_square(terms, error), most);
  find_singular_values(terms);
  if (rule_.adapt == Adapt::sigma_min) {
    const double ratio = sigma_[rule_.rank - 1] / rule_.threshold;
    return most * std::max(0.0, 1.0 - ratio * ratio);
  }
  double product = 1.0;
  for (int k = 0; k < rule_.rank; ++k) product *= sigma_[k];
  const double missing = std::max(0.0, 1.0 - product / rule_.threshold);
  return most * missing * missing;
}

// eᵀBe of the tasked terms.
double Damping::error_square(const std::vector<std::unique_ptr<RowTerm>>& terms,
                             const double* error) const {
  double sum = 0.0;
  int last = -1;
  for (const TaskedRow& tasked : rows_) {
    if (tasked.term == last) continue;
    last = tasked.term;
    const RowTerm& term = *terms[last];
    sum += term.weighed_square(error + term.data().first);
  }
  return sum * rule_.scale * rule_.scale;
}

// One-sided Jacobi: rotations make the vectors orthogonal; their lengths are the singular values.
void Damping::find_singular_values(const std::vector<std::unique_ptr<RowTerm>>& terms) {
  const int size = static_cast<int>(row_.size());
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    double* row = transposed_ ? row_.data() : vectors_.data() + r * stride_;
    std::fill_n(row, size, 0.0);
    terms[rows_[r].term]->copy_row(rows_[r].row, row);
    for (int i = 0; transposed_ && i < size; ++i) vectors_[i * stride_ + r] = row[i];
  }
  bool turned = true;
  for (int sweep = 0; turned && sweep < sweeps; ++sweep) {
    turned = false;
    for (int i = 0; i < count_; ++i) {
      for (int j = i + 1; j < count_; ++j) {
        double *a = vectors_.data() + i * stride_, *b = vectors_.data() + j * stride_;
        const double aa = dot(a, a, length_), bb = dot(b, b, length_), ab = dot(a, b, length_);
        if (!(std::abs(ab) > orthogonal * std::sqrt(aa * bb))) continue;
        turned = true;
        const double ratio = (bb - aa) / (2.0 * ab);
        const double t = std::copysign(1.0, ratio) / (std::abs(ratio) + std::hypot(1.0, ratio));
        const double c = 1.0 / std::hypot(1.0, t), s = c * t;
        for (int k = 0; k < length_; ++k) {
          const double x = a[k], y = b[k];
          a[k] = c * x - s * y;
          b[k] = s * x + c * y;
        }
      }
    }
  }
  for (int i = 0; i < count_; ++i) {
    const double* a = vectors_.data() + i * stride_;
    sigma_[i] = rule_.scale * std::sqrt(dot(a, a, length_));
  }
  std::sort(sigma_.begin(), sigma_.end(), std::greater<>());
}

}  // namespace rmrc
