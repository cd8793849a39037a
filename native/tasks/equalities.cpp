#include "tasks/equalities.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"
#include "base/lie.hpp"
#include "solver/tolerances.hpp"
#include "tasks/pointing.hpp"

namespace rmrc {

namespace {

constexpr double rank_share = 1e-6;    // rmrc.qp.equalities.RANK

int directions_of(const HardTerm& term) {
  return term.rows > 0 ? static_cast<int>(term.directions.size()) / term.rows : 0;
}

int directions_of(const std::vector<HardTerm>& terms) {
  int count = 0;
  for (const HardTerm& term : terms) count += directions_of(term);
  return count;
}

int longest_of(const std::vector<HardTerm>& terms) {
  int longest = 0;
  for (const HardTerm& term : terms) longest = std::max(longest, term.rows);
  return longest;
}

}  // namespace

Equalities::Equalities(const Stack& stack, const double* rate, int nv, std::vector<int> dofs,
                       std::vector<char> still, std::vector<HardTerm> terms,
                       const EqualityArrays& arrays)
    : stack_(stack),
      rate_(rate),
      nv_(nv),
      dofs_(std::move(dofs)),
      still_(std::move(still)),
      terms_(std::move(terms)),
      arrays_(arrays),
      capacity_(directions_of(terms_)),
      reduction_(capacity_, static_cast<int>(dofs_.size()), 1),
      wanted_(longest_of(terms_)) {}

void Equalities::update(bool without_bending, const double* lower) {
  const int n = static_cast<int>(dofs_.size());
  int rows = 0;
  for (const HardTerm& term : terms_) {
    if (!(without_bending && term.bends)) rows = stack_up(term, rows, lower);
  }
  count_ = reduction_.reduce(rows, n, rank_share);
  for (int r = 0; r < count_; ++r) {
    const double* row = reduction_.row(r);
    std::copy_n(row, n, arrays_.matrix + r * n);
    arrays_.right[r] = row[n];
  }
  // ‖(I − U_r U_rᵀ) ẋ‖ is the length of what U turns ẋ to in the rows left out.
  double missed = 0.0;
  for (int r = count_; r < rows; ++r) missed += reduction_.row(r)[n] * reduction_.row(r)[n];
  inconsistent_ = std::sqrt(missed) > inconsistency;
}

// The rows of E are orthogonal.
void Equalities::least_norm(double* v) const {
  const int n = static_cast<int>(dofs_.size());
  std::fill_n(v, n, 0.0);
  for (int r = 0; r < count_; ++r) {
    const double* row = arrays_.matrix + r * n;
    add_scaled(arrays_.right[r] / dot(row, row, n), row, v, n);
  }
}

// Write the rows of a task and what it asks for, and return where the next one's begin.
int Equalities::stack_up(const HardTerm& term, int at, const double* lower) {
  const int n = static_cast<int>(dofs_.size()), count = directions_of(term);
  ask(term, wanted_.data());
  const double* direction = term.directions.data();
  for (int r = 0; r < count; ++r, direction += term.rows) {
    double* row = reduction_.row(at + r);
    std::fill_n(row, n, 0.0);
    for (int k = 0; k < term.rows; ++k) {
      if (direction[k] == 0.0 || term.joint) continue;
      const double* own = stack_.jacobian + (term.first + k) * nv_;
      for (int i = 0; i < n; ++i) row[i] += direction[k] * own[dofs_[i]];
    }
    row[n] = dot(direction, wanted_.data(), term.rows);
    for (int i = 0; i < n; ++i) {
      if (term.joint) row[i] = direction[dofs_[i]];
      if (!still_[i]) continue;
      row[n] -= row[i] * lower[i];  // what it still moves while it brakes to rest
      row[i] = 0.0;
    }
  }
  return at + count;
}

// ẋ without what J v is at right angles to by definition: rmrc.tasks.base.Term.attainable.
void Equalities::ask(const HardTerm& term, double* wanted) const {
  const double *rate = rate_ + term.first, *error = stack_.error + term.first;
  std::copy_n(rate, term.rows, wanted);
  if (term.axis.empty()) return;
  double normal[3];
  Stretch::of_error(term.axis.data(), error).normal(normal);
  const double along = dot3(normal, rate);
  for (int i = 0; i < 3; ++i) wanted[i] -= normal[i] * along;
}

}  // namespace rmrc
