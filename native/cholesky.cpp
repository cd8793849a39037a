#include "cholesky.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels.hpp"

namespace rmrc {

Cholesky::Cholesky(int capacity)
    : stride_((capacity + 3) / 4 * 4),
      factor_(static_cast<std::size_t>(stride_) * capacity),
      inverse_diagonal_(capacity),
      work_(capacity) {}

double Cholesky::inverse_root(double pivot, double diagonal) const {
  const double smallest = 4.0 * std::numeric_limits<double>::epsilon() * diagonal;
  return 1.0 / std::sqrt(std::max(pivot, smallest));
}

void Cholesky::factorize(const double* H, int stride, const int* index, int size) {
  size_ = size;
  for (int j = 0; j < size; ++j) {
    double* own = column(j);
    const double* row = H + index[j] * stride;
    for (int i = j; i < size; ++i) own[i] = row[index[i]];
    const double diagonal = own[j];
    // Row j of the columns before, negated: what this column takes of each.
    for (int k = 0; k < j; ++k) work_[k] = -column(k)[j];
    add_combination(work_.data(), factor_.data() + j, stride_, j, own + j, size - j);
    const double inverse = inverse_root(own[j], diagonal);
    inverse_diagonal_[j] = inverse;
    own[j] = 1.0 / inverse;
    for (int i = j + 1; i < size; ++i) own[i] *= inverse;
  }
}

void Cholesky::append(const double* new_column, double diagonal) {
  const int last = size_;
  std::copy_n(new_column, last, work_.begin());
  forward(work_.data());
  for (int j = 0; j < last; ++j) column(j)[last] = work_[j];
  const double inverse = inverse_root(diagonal - dot(work_.data(), work_.data(), last), diagonal);
  inverse_diagonal_[last] = inverse;
  column(last)[last] = 1.0 / inverse;
  ++size_;
}

void Cholesky::remove(int position) {
  const int left = size_ - 1;
  // The columns before lose a row; those behind take over the removed column, as a change of rank
  // one: L'L'ᵀ = L L ᵀ + w wᵀ, one rotation of (column, w) for each.
  double* w = work_.data();
  std::copy_n(column(position) + position + 1, left - position, w + position);
  for (int j = 0; j < position; ++j) {
    double* own = column(j);
    std::copy(own + position + 1, own + size_, own + position);
  }
  for (int j = position; j < left; ++j) {
    const double* old = column(j + 1) + 1;  // old[i] is of the row that becomes row i
    double* own = column(j);
    const double diagonal = std::sqrt(old[j] * old[j] + w[j] * w[j]);
    const double inverse = 1.0 / diagonal;
    const double cosine = old[j] * inverse, sine = w[j] * inverse;
    own[j] = diagonal;
    inverse_diagonal_[j] = inverse;
    for (int i = j + 1; i < left; ++i) {
      const double value = old[i];
      own[i] = cosine * value + sine * w[i];
      w[i] = cosine * w[i] - sine * value;
    }
  }
  size_ = left;
}

void Cholesky::forward(double* x, int from) const {
  for (int j = from; j < size_; ++j) {
    x[j] *= inverse_diagonal_[j];
    add_scaled(-x[j], column(j) + j + 1, x + j + 1, size_ - j - 1);
  }
}

void Cholesky::backward(double* x) const {
  for (int j = size_ - 1; j >= 0; --j) {
    const double known = dot(column(j) + j + 1, x + j + 1, size_ - j - 1);
    x[j] = (x[j] - known) * inverse_diagonal_[j];
  }
}

}  // namespace rmrc
