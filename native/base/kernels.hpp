// The inner loops of the linear algebra, on arrays of doubles.
//
// They work on four lanes at once, in an order of their own, so that a build gives the same bits on
// every run. GCC and Clang turn a `Quad` into what vector instructions the machine has.
#pragma once

#include <cstring>

namespace rmrc {

using Quad [[gnu::vector_size(32)]] = double;

inline Quad load(const double* x) noexcept {
  Quad lanes;
  std::memcpy(&lanes, x, sizeof lanes);
  return lanes;
}

inline void store(const Quad& lanes, double* x) noexcept { std::memcpy(x, &lanes, sizeof lanes); }

/// Return Σ xᵢ yᵢ over n elements.
inline double dot(const double* x, const double* y, int n) noexcept {
  Quad even{}, odd{};
  int i = 0;
  for (; i + 8 <= n; i += 8) {
    even += load(x + i) * load(y + i);
    odd += load(x + i + 4) * load(y + i + 4);
  }
  if (i + 4 <= n) {
    even += load(x + i) * load(y + i);
    i += 4;
  }
  double rest = 0.0;
  for (; i < n; ++i) rest += x[i] * y[i];
  const Quad sums = even + odd;
  return ((sums[0] + sums[2]) + (sums[1] + sums[3])) + rest;
}

/// y += a x over n elements.
inline void add_scaled(double a, const double* x, double* y, int n) noexcept {
  int i = 0;
  for (; i + 4 <= n; i += 4) store(load(y + i) + a * load(x + i), y + i);
  for (; i < n; ++i) y[i] += a * x[i];
}

/// y += a₀x₀ + a₁x₁ + a₂x₂ + a₃x₃ over n elements, of vectors that lie `stride` apart: y is read
/// and written once for the four.
inline void add_four_scaled(const double* a, const double* x, int stride, double* y,
                            int n) noexcept {
  const double *x0 = x, *x1 = x0 + stride, *x2 = x1 + stride, *x3 = x2 + stride;
  const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
  int i = 0;
  for (; i + 4 <= n; i += 4) {
    const Quad first = a0 * load(x0 + i) + a1 * load(x1 + i);
    const Quad second = a2 * load(x2 + i) + a3 * load(x3 + i);
    store(load(y + i) + (first + second), y + i);
  }
  for (; i < n; ++i) y[i] += (a0 * x0[i] + a1 * x1[i]) + (a2 * x2[i] + a3 * x3[i]);
}

/// sums = (x₀ᵀy, x₁ᵀy, x₂ᵀy, x₃ᵀy) over n elements, of vectors that lie `stride` apart.
inline void four_dots(const double* x, int stride, const double* y, int n, double* sums) noexcept {
  for (int k = 0; k < 4; ++k) sums[k] = 0.0;
  Quad partial[4] = {};
  int i = 0;
  for (; i + 4 <= n; i += 4) {
    const Quad lanes = load(y + i);
    for (int k = 0; k < 4; ++k) partial[k] += load(x + k * stride + i) * lanes;
  }
  for (; i < n; ++i) {
    for (int k = 0; k < 4; ++k) sums[k] += x[k * stride + i] * y[i];
  }
  for (int k = 0; k < 4; ++k) {
    sums[k] += (partial[k][0] + partial[k][2]) + (partial[k][1] + partial[k][3]);
  }
}

}  // namespace rmrc
