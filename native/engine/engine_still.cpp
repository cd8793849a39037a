// How the robot comes to rest: braking in time, and what no cost draws or lower levels cost.

#include <algorithm>
#include <cmath>

#include "base/kernels.hpp"
#include "engine/engine.hpp"

namespace rmrc {

namespace {

constexpr double longest = 3.0;    // rmrc.qp.curvature.LONGEST
constexpr double weak = 0.02;      // rmrc.qp.yielding.WEAK
constexpr double spared = 0.005;   // rmrc.qp.yielding.SPARED
constexpr double slight = 1e-12;    // rmrc.qp.yielding.SLIGHT
constexpr double resolved = 1e-12;  // rmrc.qp.yielding.RESOLVED
constexpr double at_bound = 1e-7;  // rmrc.qp.yielding.AT_BOUND

}  // namespace

// Slow down what drives the errors: rmrc.qp.braking.
void Engine::brake_in_time() {
  const int n = size(), nv = mujoco_.nv;
  double *driven = braking_.driven(), *way = braking_.way(), gain = 0.0;
  std::fill_n(driven, n, 0.0);
  std::fill_n(way, n, 0.0);
  for (const auto& term : rows_) {
    if (!term->counts() || term->data().gain == 0.0) continue;
    const double capped = std::min(term->data().gain, 1.0 / dt_);
    term->pull(program_.rate, capped, driven, way);
    gain = std::max(gain, capped);
  }
  for (const JointTerm& term : joints_) {
    if (term.data.gain == 0.0) continue;
    const double capped = std::min(term.data.gain, 1.0 / dt_);
    unfed_.assign(program_.rate + term.data.first, program_.rate + term.data.first + nv);
    for (int i = 0; i < nv; ++i) unfed_[i] -= stack_.feedforward[term.data.first + i];
    for (int i = 0; i < n; ++i) {
      const double pulled = term.weighed(constants_.dofs[i], unfed_.data());
      driven[i] += pulled;
      way[i] += pulled / capped;
    }
    if (term.counts()) gain = std::max(gain, capped);
  }
  if (gain == 0.0) return;
  const double share = braking_.slow(program_.H, gain, dt_);
  if (share < 0.0) return;
  if (cascade_ != nullptr) {
    const auto scale = [&](const TermData& data) {
      for (int i = data.first; i < data.first + data.rows; ++i) {
        program_.rate[i] -= (1.0 - share) * (program_.rate[i] - stack_.feedforward[i]);
      }
    };
    for (const auto& term : rows_) {
      if (term->counts() && term->data().gain != 0.0) scale(term->data());
    }
    for (const JointTerm& term : joints_) {
      if (term.counts() && term.data.gain != 0.0) scale(term.data);
    }
  } else if (braking_.jerks() && is_still()) {
    const double* w = braking_.followed(share, v_previous_.data(), dt_);
    for (int i = 0; i < n; ++i) program_.g[i] += driven[i] - dot(program_.H + i * n, w, n);
  } else {
    for (int i = 0; i < n; ++i) program_.g[i] += (1.0 - share) * driven[i];
  }
}

// Whether no target that a task has a gain for moves.
bool Engine::is_still() const {
  const auto rests = [&](const TermData& data) {
    const double* fed = stack_.feedforward + data.first;
    return data.gain == 0.0 || std::all_of(fed, fed + data.rows, [](double x) { return x == 0.0; });
  };
  return std::all_of(rows_.begin(), rows_.end(), [&](const auto& t) { return rests(t->data()); }) &&
         std::all_of(joints_.begin(), joints_.end(), [&](const auto& t) { return rests(t.data); });
}

// What the hard tasks ask for: near a singularity those that bend are a cost, above all others.
void Engine::update_equalities() {
  softened_ = false;
  equalities_->update(false, program_.lb);
  const bool any = std::any_of(rows_.begin(), rows_.end(),
                               [](const auto& term) { return term->is_hard(); });
  if (!any || !is_still() || !cannot_hold()) return;
  softened_ = true;
  if (cascade_ == nullptr) soften();
  equalities_->update(true, program_.lb);
}

// Whether E v = f has no v, or one at which V may rise, cut to the velocity limits, or one near a
// singularity.
bool Engine::cannot_hold() {
  if (equalities_->inconsistent()) return true;
  const auto hard = [](const RowTerm& term) { return term.is_hard(); };
  equalities_->least_norm(least_norm_.data());
  if (is_weak(least_norm_.data(), hard)) return true;
  double faster = 1.0;
  for (int i = 0; i < size(); ++i) {
    const double limit = box_.limits().velocity[i];
    if (limit > 0.0) faster = std::max(faster, std::abs(least_norm_[i]) / limit);
  }
  for (int i = 0; i < size(); ++i) least_norm_[i] /= faster;
  return passes(least_norm_.data(), hard);
}

// Whether V may rise where some terms that no cost draws get v: rmrc.qp.curvature.Curvature.passes.
template <class Which>
bool Engine::passes(const double* v, Which which) {
  std::fill(curvature_.begin(), curvature_.end(), 0.0);
  double drawn = 0.0, curved = 0.0;
  for (const auto& term : rows_) {
    if (!term->exact() || !which(*term)) continue;
    drawn += term->drawn(program_.rate, v, dt_, curved);
    term->add_curvature(program_.rate, dt_, constants_.least_curvature, curvature_.data());
  }
  for (int i = 0; i < size(); ++i) curved += longest * curvature_[i] * v[i] * v[i];
  return curved > 2.0 * drawn;
}

// Whether some terms that no cost draws hardly move at v, which is near a singularity.
template <class Which>
bool Engine::is_weak(const double* v, Which which) {
  const int n = size();
  double moved = 0.0, lengths = 0.0;
  for (const auto& term : rows_) {
    if (!term->exact() || !which(*term)) continue;
    for (int r = 0; r < term->data().rows; ++r) {
      std::fill(exact_.begin(), exact_.end(), 0.0);
      term->exact_row(r, program_.rate, exact_.data());
      const double along = dot(exact_.data(), v, n);
      moved += along * along;
      lengths += dot(exact_.data(), exact_.data(), n);
    }
  }
  return std::sqrt(moved) < weak * std::sqrt(lengths) * std::sqrt(dot(v, v, n));
}

// Whether V may rise for what preserves its direction, or it is near a singularity.
bool Engine::turns_back() {
  if (!is_still()) return false;
  int k = 0;
  for (const LevelTasks& tasks : levels_->tasks()) {
    if (tasks.hard && !softened_) continue;
    const double* v = cascade_->directed(k++);
    if (v == nullptr) return false;
    const auto directed = [&](const RowTerm& term) {
      return std::any_of(tasks.parts.begin(), tasks.parts.end(), [&](const auto& part) {
        return rows_[part.term].get() == &term && !part.directed.empty();
      });
    };
    const bool any = std::any_of(rows_.begin(), rows_.end(), [&](const auto& term) {
      return term->exact() && directed(*term);
    });
    if (!any || std::sqrt(dot(v, v, size())) < slight) continue;
    if (passes(v, directed) || is_weak(v, directed)) return true;
  }
  return false;
}

// Have the hard tasks that bend in the cost, with their X.
void Engine::soften() {
  const int n = size();
  const double share = 1.0 / constants_.soft_ratio;
  double *H = program_.H, *g = program_.g;
  std::fill(curvature_.begin(), curvature_.end(), 0.0);
  for (const auto& term : rows_) {
    if (!term->is_hard()) continue;
    term->add_curvature(program_.rate, dt_, constants_.least_curvature, curvature_.data());
    for (int r = 0; r < term->data().rows; ++r) {
      std::fill(exact_.begin(), exact_.end(), 0.0);
      const double wanted = term->exact_row(r, program_.rate, exact_.data());
      for (int i = 0; i < n; ++i) {
        if (exact_[i] == 0.0) continue;
        add_scaled(share * exact_[i], exact_.data(), H + i * n, n);
        g[i] -= share * exact_[i] * wanted;
      }
    }
  }
  for (int i = 0; i < n; ++i) H[i * n + i] += share * curvature_[i];
}

// By how much v misses what is asked of the hard tasks that are a cost.
double Engine::missed_softly() {
  double square = 0.0;
  for (const auto& term : rows_) {
    if (!term->is_hard()) continue;
    for (int r = 0; r < term->data().rows; ++r) {
      std::fill(exact_.begin(), exact_.end(), 0.0);
      const double wanted = term->exact_row(r, program_.rate, exact_.data());
      const double missed = dot(exact_.data(), v_.data(), size()) - wanted;
      square += missed * missed;
    }
  }
  return std::sqrt(square);
}

// Leave less of what lower levels cost those above where those are singular:
// rmrc.qp.yielding.Yielding.spare.
void Engine::spare(const std::vector<Level>& levels) {
  const std::vector<LevelTasks>& all = levels_->tasks();
  const int n = size(), first = !softened_ && !all.empty() && all.front().hard ? 1 : 0;
  int count = 0;
  while (cascade_->optimum(count) != nullptr) ++count;
  for (int k = count - 2; k >= 0; --k) {
    if (first + k >= static_cast<int>(all.size())) continue;
    const Level& level = levels[first + k];
    const LevelTasks& tasks = all[first + k];
    const double *at = cascade_->optimum(k), *before = k > 0 ? cascade_->optimum(k - 1) : nullptr;
    const int m = level.rows;
    double gained = 0.0, cost = 0.0;
    for (int r = 0; r < m; ++r) {
      const double* row = level.matrix + r * n;
      const double moved = dot(row, at, n);
      gained += level.rate[r] * (moved - (before != nullptr ? dot(row, before, n) : 0.0));
      missed_[r] = level.rate[r] - moved;
    }
    for (int r = 0; r < m; ++r) {
      for (int s = 0; s <= r; ++s) {
        double sum = 0.0;
        for (int i = 0; i < n; ++i) {
          const bool free = at[i] > program_.lb[i] + at_bound && at[i] < program_.ub[i] - at_bound;
          if (free) sum += level.matrix[r * n + i] * level.matrix[s * n + i];
        }
        gram_[r * m + s] = gram_[s * m + r] = sum;
      }
    }
    double damping = dt_ * dt_;
    for (int r = 0; r < m; ++r) damping = std::max(damping, resolved * gram_[r * m + r]);
    for (int r = 0; r < m; ++r) gram_[r * m + r] += damping;
    gram_factor_->factorize(gram_.data(), m, all_rows_.data(), m);
    gram_factor_->forward(missed_.data());
    gram_factor_->backward(missed_.data());
    for (int r = 0; r < m; ++r) missed_[r] *= damping;
    for (int i = 0; i < n; ++i) exact_[i] = v_[i] - at[i];
    const double* missed = missed_.data();
    for (const LevelTasks::Part& part : tasks.parts) {
      RowTerm& term = *rows_[part.term];
      if (term.has_way()) cost += dt_ * term.bent(missed, exact_.data());
      missed += term.data().rows;
    }
    const double most = std::max(0.0, spared * gained);
    if (!(cost > most)) continue;
    const double share = std::sqrt(most / cost);
    for (int i = 0; i < n; ++i) v_[i] = at[i] + share * exact_[i];
  }
}

}  // namespace rmrc
