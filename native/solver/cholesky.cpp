#include "solver/cholesky.hpp"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// Up to so many variables, an arm's, loops of known length take a third of the instructions.
constexpr int most_small = 8;

// Call an action with a size that is known to the compiler, if it is small.
template <int size = most_small, class Action>
bool with_small(int actual, Action action) {
  if constexpr (size > 0) {
    if (actual == size) {
      action(std::integral_constant<int, size>());
      return true;
    }
    return with_small<size - 1>(actual, action);
  }
  return false;
}

}  // namespace

Cholesky::Cholesky(int capacity)
    : stride_((capacity + 3) / 4 * 4),
      factor_(static_cast<std::size_t>(stride_) * stride_),
      diagonal_(stride_),
      inverse_diagonal_(stride_),
      work_(capacity) {}

double Cholesky::inverse_root(double pivot, double diagonal) const {
  const double smallest = 4.0 * epsilon * diagonal;
  return 1.0 / std::sqrt(std::max(pivot, smallest));
}

void Cholesky::factorize(const double* H, int stride, const int* index, int size) {
  size_ = size;
  if (with_small(size, [&](auto known) { factorize_small<known()>(H, stride, index); })) return;
  const int padded = (size + 3) / 4 * 4;  // to whole tiles, with ones on the diagonal
  for (int j = 0; j < padded; ++j) {
    double* own = column(j);
    std::fill(own + j / 4 * 4, own + j, 0.0);
    if (j < size) {
      const double* row = H + index[j] * stride;
      for (int i = j; i < size; ++i) own[i] = row[index[i]];
    }
    std::fill(own + std::max(j, size), own + padded, 0.0);
    if (j >= size) own[j] = 1.0;
    diagonal_[j] = own[j];
  }
  for (int j = 0; j < padded; j += 4) {
    for (int i = j; i < padded; i += 4) {
      subtract_products(i, j);
      if (i == j) {
        factorize_tile(j);
      } else {
        solve_tile(i, j);
      }
    }
  }
}

template <int size>
void Cholesky::factorize_small(const double* H, int stride, const int* index) {
  double L[size][size], inverse[size];  // by columns
#pragma GCC unroll 8
  for (int j = 0; j < size; ++j) {
    const double* row = H + index[j] * stride;
#pragma GCC unroll 8
    for (int i = j; i < size; ++i) L[j][i] = row[index[i]];
  }
#pragma GCC unroll 8
  for (int j = 0; j < size; ++j) {
    const double diagonal = L[j][j];
#pragma GCC unroll 8
    for (int k = 0; k < j; ++k) {
#pragma GCC unroll 8
      for (int i = j; i < size; ++i) L[j][i] -= L[k][j] * L[k][i];
    }
    diagonal_[j] = diagonal;
    inverse[j] = inverse_root(L[j][j], diagonal);
    L[j][j] = 1.0 / inverse[j];
#pragma GCC unroll 8
    for (int i = j + 1; i < size; ++i) L[j][i] *= inverse[j];
  }
#pragma GCC unroll 8
  for (int j = 0; j < size; ++j) {
    inverse_diagonal_[j] = inverse[j];
    std::copy_n(L[j] + j, size - j, column(j) + j);
  }
}

// The tile of rows i and columns j, four each, minus the products of the columns before.
void Cholesky::subtract_products(int i, int j) {
  Quad sums[4];
  for (int c = 0; c < 4; ++c) sums[c] = load(column(j + c) + i);
  const double* left = factor_.data();
  for (int k = 0; k < j; ++k, left += stride_) {
    const Quad rows = load(left + i);
    for (int c = 0; c < 4; ++c) sums[c] -= left[j + c] * rows;
  }
  for (int c = 0; c < 4; ++c) store(sums[c], column(j + c) + i);
}

// The tile on the diagonal becomes its own factor.
void Cholesky::factorize_tile(int j) {
  for (int c = j; c < j + 4; ++c) {
    double* own = column(c);
    const double diagonal = diagonal_[c];
    double pivot = own[c];
    for (int k = j; k < c; ++k) pivot -= column(k)[c] * column(k)[c];
    const double inverse = inverse_root(pivot, diagonal);
    inverse_diagonal_[c] = inverse;
    own[c] = 1.0 / inverse;
    for (int i = c + 1; i < j + 4; ++i) {
      double value = own[i];
      for (int k = j; k < c; ++k) value -= column(k)[i] * column(k)[c];
      own[i] = value * inverse;
    }
  }
}

// A tile below the diagonal is divided by the factor of the tile on it.
void Cholesky::solve_tile(int i, int j) {
  Quad solved[4];
  for (int c = 0; c < 4; ++c) {
    Quad value = load(column(j + c) + i);
    for (int k = 0; k < c; ++k) value -= column(j + k)[j + c] * solved[k];
    solved[c] = value * inverse_diagonal_[j + c];
    store(solved[c], column(j + c) + i);
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

template <int size>
void Cholesky::forward_small(double* x) const {
#pragma GCC unroll 8
  for (int j = 0; j < size; ++j) {
    const double* own = column(j);
    const double taken = x[j] * inverse_diagonal_[j];
    x[j] = taken;
#pragma GCC unroll 8
    for (int i = j + 1; i < size; ++i) x[i] -= taken * own[i];
  }
}

template <int size>
void Cholesky::backward_small(double* x) const {
#pragma GCC unroll 8
  for (int j = size - 1; j >= 0; --j) {
    const double* own = column(j);
    double value = x[j];
#pragma GCC unroll 8
    for (int i = j + 1; i < size; ++i) value -= own[i] * x[i];
    x[j] = value * inverse_diagonal_[j];
  }
}

void Cholesky::forward(double* x, int from) const {
  if (with_small(size_, [&](auto known) { forward_small<known()>(x); })) return;
  int j = from / 4 * 4;
  for (; j + 4 <= size_; j += 4) {
    double taken[4];
    for (int c = j; c < j + 4; ++c) {
      for (int k = j; k < c; ++k) x[c] -= x[k] * column(k)[c];
      x[c] *= inverse_diagonal_[c];
      taken[c - j] = -x[c];
    }
    add_four_scaled(taken, column(j) + j + 4, stride_, x + j + 4, size_ - j - 4);
  }
  for (; j < size_; ++j) {
    x[j] *= inverse_diagonal_[j];
    add_scaled(-x[j], column(j) + j + 1, x + j + 1, size_ - j - 1);
  }
}

void Cholesky::backward(double* x) const {
  if (with_small(size_, [&](auto known) { backward_small<known()>(x); })) return;
  int j = size_ - 1;
  for (; j >= size_ / 4 * 4; --j) {
    const double known = dot(column(j) + j + 1, x + j + 1, size_ - j - 1);
    x[j] = (x[j] - known) * inverse_diagonal_[j];
  }
  for (j -= 3; j >= 0; j -= 4) {
    double known[4];
    four_dots(column(j) + j + 4, stride_, x + j + 4, size_ - j - 4, known);
    for (int c = j + 3; c >= j; --c) {
      double value = x[c] - known[c - j];
      for (int i = c + 1; i < j + 4; ++i) value -= column(c)[i] * x[i];
      x[c] = value * inverse_diagonal_[c];
    }
  }
}

}  // namespace rmrc
