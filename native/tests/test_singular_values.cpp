// Matrices whose singular values are known: found to rounding, without a call for memory.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <vector>

#include "solver/singular_values.hpp"
#include "tests/allocations.hpp"

namespace {

// Of the largest singular value: the reflections that make the matrix round as well.
constexpr double tolerance = 1e-14;
constexpr double resolution = 4.0 * std::numeric_limits<double>::epsilon();

int failures = 0;

void expect(bool holds, const char* what, int count, int length, int k) {
  if (holds) return;
  ++failures;
  std::printf("%s: %d vectors of %d, matrix %d\n", what, count, length, k);
}

// Turn all vectors (rows), or all places in them (columns), by a random reflection.
void turn(std::vector<double>& matrix, int count, int length, bool rows, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const int size = rows ? count : length, others = rows ? length : count;
  std::vector<double> u(size);
  double square = 0.0;
  for (double& element : u) square += (element = normal(random)) * element;
  for (int j = 0; j < others; ++j) {
    const auto at = [&](int i) -> double& {
      return matrix[rows ? i * length + j : j * length + i];
    };
    double sum = 0.0;
    for (int i = 0; i < size; ++i) sum += u[i] * at(i);
    for (int i = 0; i < size; ++i) at(i) -= 2.0 * sum / square * u[i];
  }
}

// Singular values of many kinds, the largest first.
std::vector<double> chosen(int count, int kind, std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform(0.1, 3.0), exponent(-14.0, 0.0);
  std::vector<double> sigma(count);
  for (double& value : sigma) value = kind == 1 ? std::pow(10.0, exponent(random)) : uniform(random);
  if (kind == 2) std::fill(sigma.begin(), sigma.end(), 0.7);
  if (kind == 3) std::fill_n(sigma.begin(), count / 2, 0.0);
  if (kind == 4) std::fill(sigma.begin(), sigma.end(), 0.0);
  if (kind == 5) sigma[0] = 1e-9;
  std::sort(sigma.rbegin(), sigma.rend());
  return sigma;
}

void check(int count, int length, std::mt19937_64& random) {
  rmrc::SingularValues values(count, length);
  std::vector<double> matrix(static_cast<std::size_t>(count) * length);
  for (int k = 0; k < 30; ++k) {
    const std::vector<double> sigma = chosen(count, k % 6, random);
    std::fill(matrix.begin(), matrix.end(), 0.0);
    for (int i = 0; i < count; ++i) matrix[i * length + i] = sigma[i];
    for (int i = 0; i < 3; ++i) {
      turn(matrix, count, length, true, random);
      turn(matrix, count, length, false, random);
    }
    const double largest = sigma[0], allowed = tolerance * largest;
    double sum = 0.0, product = 1.0;
    const long before = allocations;
    values.decompose(matrix.data());
    for (int r = 1; r <= count; ++r) {
      const double known = sigma[r - 1];
      const double most = values.sum_of_squares();
      const double found = std::sqrt(values.square(r, 0.0, most, 0.0, resolution));
      expect(std::abs(found - known) <= allowed, "wrong", count, length, k);
      const double above = known + 2.0 * allowed, below = known - 2.0 * allowed;
      expect(above <= 0.0 || !values.at_least(r, above * above), "too large", count, length, k);
      expect(below <= 0.0 || values.at_least(r, below * below), "too small", count, length, k);
      sum += known * known;
      product *= known;
    }
    expect(allocations == before, "called for memory", count, length, k);
    expect(std::abs(values.sum_of_squares() - sum) <= 10 * tolerance * sum, "sum", count, length, k);
    if (k % 6 == 0 || k % 6 == 2) {
      const double apart = std::abs(values.product() - product);
      expect(apart <= 100 * count * tolerance * product, "product", count, length, k);
    }
  }
}

}  // namespace

int main() {
  std::mt19937_64 random(0);
  for (const int count : {1, 2, 3, 4, 5, 6, 9, 16, 33}) {
    for (const int more : {0, 1, 3, 10}) check(count, count + more, random);
  }
  std::printf("%d failures\n", failures);
  return failures == 0 ? 0 : 1;
}
