#include "engine/correction.hpp"

#include <algorithm>
#include <cmath>

namespace rmrc {

namespace {

// rmrc.engine.correction: ENOUGH, SPARE and INSIDE; and rmrc.qp.rows.FASTEST.
constexpr double enough = 1.1;
constexpr double spare = 0.1;
constexpr double inside = 1e-7;
constexpr double fastest_rate = 1e6;

}  // namespace

void Correction::begin() { std::fill_n(raised_.begin(), rows_.count(), 0.0); }

void Correction::see(const Kinematics& end, double time) {
  const double aside = spare * rows_.resolution();
  for (const Block& block : rows_.blocks()) {
    for (int row = block.first; row < block.first + block.count; ++row) {
      const double after = block.barrier->distance(end, static_cast<int>(rows_.arrays().ids[row]));
      const double shortfall = std::min(rows_.arrays().distance[row], 0.0) + aside - after;
      if (!(shortfall > aside)) continue;
      raised_[row] = std::max(raised_[row], enough / time * shortfall);
    }
  }
}

bool Correction::raise_rows(const double* lb, const double* ub, double* lower) const {
  bool fell_short = false;
  for (const Block& block : rows_.blocks()) {
    const auto first = raised_.begin() + block.first;
    if (std::all_of(first, first + block.count, [](double more) { return more == 0.0; })) continue;
    fell_short = true;
    for (int row = block.first; row < block.first + block.count; ++row) {
      const double most = fastest(row, lb, ub);
      lower[row] = std::min(lower[row] + raised_[row], most - inside * std::abs(most));
    }
  }
  return fell_short;
}

// Return the most that the box alone allows of a row; 0 · ∞ would be no number.
double Correction::fastest(int row, const double* lb, const double* ub) const {
  const int n = static_cast<int>(rows_.dofs().size());
  const double* slope = rows_.arrays().matrix + static_cast<long>(row) * n;
  double most = 0.0;
  for (int k = 0; k < n; ++k) {
    const double low = std::max(lb[k], -fastest_rate), high = std::min(ub[k], fastest_rate);
    most += std::max(slope[k] * low, slope[k] * high);
  }
  return most;
}

}  // namespace rmrc
