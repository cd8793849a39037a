#include "tasks/damping.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/numbers.hpp"

namespace rmrc {

namespace {

// σ² is found to this, relative to ε²; λ_a² is linear in it.
constexpr double resolution = 4.0 * epsilon;
// The bound of a reference need not be close: relative to ε².
constexpr double bound_resolution = 0.05;
// What rounding can do to a singular value, relative to the norm of W, and more.
constexpr double rounding = 1e-12;

}  // namespace

Damping::Damping(DampingRule rule, std::vector<TaskedRow> rows, int size)
    : rule_(rule),
      rows_(std::move(rows)),
      size_(size),
      count_(std::min(static_cast<int>(rows_.size()), size)),
      length_(std::max(static_cast<int>(rows_.size()), size)),
      transposed_(static_cast<int>(rows_.size()) > size),
      weighted_(static_cast<std::size_t>(count_) * length_),
      row_(size),
      values_(count_, length_),
      reference_(weighted_) {}

double Damping::square(const std::vector<std::unique_ptr<RowTerm>>& terms, const double* error) {
  const double most = rule_.largest * rule_.largest;
  switch (rule_.adapt) {
    case Adapt::off:
      return 0.0;
    case Adapt::error:
      return std::min(0.5 * error_square(terms, error), most);
    case Adapt::sigma_min:
      gather(terms);
      return most * by_sigma_min();
    case Adapt::manipulability:
      gather(terms);
      return most * by_manipulability();
  }
  return 0.0;
}

// W, whose elements in the columns that move no row stay 0.
void Damping::gather(const std::vector<std::unique_ptr<RowTerm>>& terms) {
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    const RowTerm& term = *terms[rows_[r].term];
    if (!transposed_) {
      term.copy_row(rows_[r].row, weighted_.data() + r * length_);
      continue;
    }
    std::fill_n(row_.begin(), size_, 0.0);
    term.copy_row(rows_[r].row, row_.data());
    for (int i = 0; i < size_; ++i) weighted_[static_cast<std::size_t>(i) * length_ + r] = row_[i];
  }
}

// 1 − (σ/ε)², or 0. Far from singularities σ_r is not looked for: by Weyl it has changed by no more
// than the Frobenius norm of what W has changed by. What comes of it is the same bit by bit.
double Damping::by_sigma_min() {
  const double threshold = rule_.threshold / rule_.scale, square = threshold * threshold;
  double change = 0.0;
  for (std::size_t i = 0; i < weighted_.size(); ++i) {
    const double difference = weighted_[i] - reference_[i];
    change += difference * difference;
  }
  if (bound_ - std::sqrt(change) > threshold) return 0.0;
  values_.decompose(weighted_.data());
  if (!values_.at_least(rule_.rank, square)) {
    bound_ = 0.0;
    return 1.0 - values_.square(rule_.rank, 0.0, square, resolution * square, 0.0) / square;
  }
  const double largest = values_.sum_of_squares();
  const double least =
      values_.square(rule_.rank, square, std::max(square, largest), bound_resolution * square, 0.0);
  reference_ = weighted_;
  bound_ = std::sqrt(least) - rounding * std::sqrt(largest);
  return 0.0;
}

// (1 − w/w₀)², or 0.
double Damping::by_manipulability() {
  values_.decompose(weighted_.data());
  double product = 1.0;
  if (rule_.rank == count_) {
    product = values_.product() * std::pow(rule_.scale, count_);
  } else {
    const double largest = values_.sum_of_squares();
    for (int r = 1; r <= rule_.rank; ++r) {
      const double square = values_.square(r, 0.0, largest, 0.0, resolution);
      product *= rule_.scale * std::sqrt(square);
    }
  }
  const double missing = std::max(0.0, 1.0 - product / rule_.threshold);
  return missing * missing;
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

}  // namespace rmrc
