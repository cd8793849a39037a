// The inner loops of the linear algebra, on arrays of doubles.
//
// Each fixes the order of its sums, so that a build gives the same bits on every run; that order
// leaves independent lanes, which the compiler turns into vector instructions.
#pragma once

namespace rmrc {

/// Return Σ xᵢ yᵢ over n elements, in eight partial sums.
inline double dot(const double* x, const double* y, int n) noexcept {
  constexpr int lanes = 8;
  double sums[lanes] = {};
  int i = 0;
  for (; i + lanes <= n; i += lanes) {
    for (int k = 0; k < lanes; ++k) sums[k] += x[i + k] * y[i + k];
  }
  double rest = 0.0;
  for (; i < n; ++i) rest += x[i] * y[i];
  return ((sums[0] + sums[4]) + (sums[2] + sums[6])) + ((sums[1] + sums[5]) + (sums[3] + sums[7])) +
         rest;
}

/// y += a x over n elements.
inline void add_scaled(double a, const double* __restrict x, double* __restrict y, int n) noexcept {
  for (int i = 0; i < n; ++i) y[i] += a * x[i];
}

/// y += a₀x₀ + a₁x₁ + a₂x₂ + a₃x₃ over n elements: y is read and written once for the four.
inline void add_four_scaled(const double* a, const double* __restrict x0,
                            const double* __restrict x1, const double* __restrict x2,
                            const double* __restrict x3, double* __restrict y, int n) noexcept {
  const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
  for (int i = 0; i < n; ++i) y[i] += (a0 * x0[i] + a1 * x1[i]) + (a2 * x2[i] + a3 * x3[i]);
}

/// y += Σ aⱼ xⱼ over n elements, for `count` vectors xⱼ that lie `stride` apart.
inline void add_combination(const double* a, const double* x, int stride, int count, double* y,
                            int n) noexcept {
  int j = 0;
  for (; j + 4 <= count; j += 4) {
    const double* first = x + j * stride;
    add_four_scaled(a + j, first, first + stride, first + 2 * stride, first + 3 * stride, y, n);
  }
  for (; j < count; ++j) add_scaled(a[j], x + j * stride, y, n);
}

}  // namespace rmrc
