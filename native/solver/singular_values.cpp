#include "solver/singular_values.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr int quads = 4, lanes = 4 * quads;
constexpr int most_rounds = 100;  // each makes an interval 17 times smaller
// In place of a pivot of 0; its quotients stay within the range of a double.
constexpr double least_pivot = 1e-200;

using Count = decltype(Quad{} < Quad{});  // −1 in each lane where it holds

// A reflection I − t u uᵀ that leaves of x nothing but its first element, which becomes `rest`; x
// becomes u. It is none where x is 0.
struct Reflection {
  double rest, t;
};

Reflection reflect(double* x, double square) {
  if (!(square > 0.0)) return {0.0, 0.0};
  const double length = std::sqrt(square), first = x[0];
  x[0] += std::copysign(length, first);
  return {-std::copysign(length, first), 1.0 / (square + std::abs(first) * length)};
}

}  // namespace

SingularValues::SingularValues(int count, int length)
    : count_(count),
      length_(length),
      vectors_(static_cast<std::size_t>(count) * length),
      along_(length),
      dots_(count),
      diagonal_(count),
      beside_(count),
      squares_(count),
      beside_squares_(count) {}

void SingularValues::decompose(const double* matrix) {
  std::copy_n(matrix, vectors_.size(), vectors_.begin());
  for (int i = 0; i < count_; ++i) {
    reflect_row(i);
    if (i + 1 < count_) reflect_column(i);
  }
  for (int i = 0; i < count_; ++i) {
    squares_[i] = diagonal_[i] * diagonal_[i];
    beside_squares_[i] = beside_[i] * beside_[i];
  }
}

// Leave of the vector i nothing beyond element i, by a reflection of the elements from there.
void SingularValues::reflect_row(int i) {
  const int size = length_ - i;
  double* u = vectors_.data() + static_cast<std::size_t>(i) * length_ + i;
  const Reflection found = reflect(u, dot(u, u, size));
  diagonal_[i] = found.rest;
  double* row = u + length_;
  int r = i + 1;
  for (; r + 4 <= count_; r += 4, row += 4 * static_cast<std::ptrdiff_t>(length_)) {
    double sums[4];
    four_dots(row, length_, u, size, sums);
    for (int k = 0; k < 4; ++k) add_scaled(-found.t * sums[k], u, row + k * length_, size);
  }
  for (; r < count_; ++r, row += length_) {
    add_scaled(-found.t * dot(row, u, size), u, row, size);
  }
}

// Leave of element i of the vectors after i + 1 nothing, by a reflection of the vectors after i.
void SingularValues::reflect_column(int i) {
  const int size = length_ - i - 1, rows = count_ - i - 1;
  double* first = vectors_.data() + static_cast<std::size_t>(i + 1) * length_ + i;
  double* u = dots_.data();
  for (int r = 0; r < rows; ++r) u[r] = first[r * length_];
  const Reflection found = reflect(u, dot(u, u, rows));
  beside_[i] = found.rest;
  double* along = along_.data();
  std::fill_n(along, size, 0.0);
  int r = 0;
  for (; r + 4 <= rows; r += 4) add_four_scaled(u + r, first + 1 + r * length_, length_, along, size);
  for (; r < rows; ++r) add_scaled(u[r], first + 1 + r * length_, along, size);
  for (r = 0; r < rows; ++r) add_scaled(-found.t * u[r], along, first + 1 + r * length_, size);
}

// Pivots of BᵀB − x, of as many x as there are lanes.
void SingularValues::count_below(const double* points, int* below) const {
  Quad x[quads], rest[quads];
  Count negative[quads] = {};
  for (int q = 0; q < quads; ++q) {
    x[q] = load(points + 4 * q);
    rest[q] = -x[q];
  }
  for (int i = 0; i < count_; ++i) {
    for (int q = 0; q < quads; ++q) {
      Quad pivot = squares_[i] + rest[q];
      pivot = ((pivot < least_pivot) & (pivot > -least_pivot)) ? Quad{} - least_pivot : pivot;
      negative[q] -= pivot < 0.0;
      rest[q] = beside_squares_[i] * (rest[q] / pivot) - x[q];
    }
  }
  for (int k = 0; k < lanes; ++k) below[k] = static_cast<int>(negative[k / 4][k % 4]);
}

bool SingularValues::at_least(int place, double square) const {
  double points[lanes];
  int below[lanes];
  std::fill_n(points, lanes, square);
  count_below(points, below);
  return below[0] <= count_ - place;
}

double SingularValues::square(int place, double low, double high, double absolute,
                              double relative) const {
  double points[lanes];
  int below[lanes];
  for (int k = 0; high - low > absolute + relative * low && k < most_rounds; ++k) {
    const double part = (high - low) / (lanes + 1);
    for (int j = 0; j < lanes; ++j) points[j] = low + (j + 1) * part;
    count_below(points, below);
    int j = 0;
    while (j < lanes && below[j] <= count_ - place) ++j;
    if (j < lanes) high = points[j];
    if (j > 0) low = points[j - 1];
  }
  return low;
}

double SingularValues::sum_of_squares() const {
  double sum = 0.0;
  for (int i = 0; i < count_; ++i) sum += squares_[i] + beside_squares_[i];
  return sum;
}

double SingularValues::product() const {
  double product = 1.0;
  for (const double element : diagonal_) product *= std::abs(element);
  return product;
}

}  // namespace rmrc
