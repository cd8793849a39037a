#include "tasks/levels.hpp"

#include <algorithm>
#include <utility>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double least_damping = 1e-12;  // rmrc.qp.assemble.LEAST_DAMPING

}  // namespace

Levels::Levels(std::vector<LevelTasks> tasks, LastMetric metric, std::vector<int> dofs, int nv,
               const std::vector<std::unique_ptr<RowTerm>>& terms)
    : tasks_(std::move(tasks)), metric_(std::move(metric)), dofs_(std::move(dofs)), nv_(nv) {
  int rows = 0, directed = 0;
  for (const LevelTasks& level : tasks_) {
    int own = 0, along = 0;
    for (const LevelTasks::Part& part : level.parts) {
      own += terms[part.term]->data().rows;
      along += static_cast<int>(part.directed.size());
    }
    for (const LevelTasks::JointPart& part : level.joints) {
      own += static_cast<int>(part.root.size()) / nv_;
    }
    levels_.push_back({own, nullptr, nullptr, nullptr, 0.0, nullptr, along, nullptr, nullptr,
                       !level.hard});
    directed_.push_back(along);
    rows += own;
    directed += along;
    sizes_.rows = std::max(sizes_.rows, own);
    sizes_.directed = std::max(sizes_.directed, along);
  }
  levels_.push_back({0, nullptr, nullptr, nullptr, 1.0, nullptr, 0, nullptr, nullptr, true});
  sizes_.levels = static_cast<int>(levels_.size());
  const std::size_t n = dofs_.size();
  matrix_.resize(rows * n);
  rate_.resize(rows);
  jacobian_.resize(directed * n);
  direction_.resize(directed);
  curvature_.resize(tasks_.size() * n);
  exact_curvature_.resize(curvature_.size());
  curved_.resize(tasks_.size());
  const auto& constant = metric_.constant;
  const auto counts = [](double value) { return value != 0.0; };
  const bool weighs =
      metric_.inertia != 0.0 || std::any_of(constant.begin(), constant.end(), counts);
  if (weighs) last_.resize(n * n);
  int row = 0, along = 0;
  for (Level& level : levels_) {
    level.matrix = matrix_.data() + row * n;
    level.rate = rate_.data() + row;
    level.jacobian = jacobian_.data() + along * n;
    level.direction = direction_.data() + along;
    row += level.rows;
    along += level.directed;
  }
}

const std::vector<Level>& Levels::gather(const std::vector<std::unique_ptr<RowTerm>>& terms,
                                         const Stack& stack, const double* rate,
                                         const double* inertia, double damping,
                                         const Manner& manner) {
  const double least = std::max(damping, least_damping);
  for (std::size_t k = 0; k < tasks_.size(); ++k) {
    Level& level = levels_[k];
    const bool directs = directed_[k] > 0;
    level.damping = least;
    level.curvature = curved_[k];
    level.directed = manner.directed ? directed_[k] : 0;
    level.asked = manner.softened || !tasks_[k].hard;
    if (!level.asked) continue;
    gather(tasks_[k], terms, stack, rate, level);
    if (tasks_[k].hard || (directs && !manner.directed)) bound_exact(k, terms, rate, manner);
  }
  if (!last_.empty()) {
    write_metric(inertia, least);
    levels_.back().metric = last_.data();
  }
  return levels_;
}

void Levels::curve(const std::vector<std::unique_ptr<RowTerm>>& terms, const double* rate,
                   double dt, double least) {
  const std::size_t n = dofs_.size();
  std::fill(curvature_.begin(), curvature_.end(), 0.0);
  for (std::size_t k = 0; k < tasks_.size(); ++k) {
    // A level bears the curvature of those above it, too: what it moves costs them the second order.
    double* curvature = curvature_.data() + k * n;
    if (k > 0) std::copy_n(curvature - n, n, curvature);
    curved_[k] = k > 0 && curved_[k - 1] != nullptr ? curvature : nullptr;
    for (const LevelTasks::Part& part : tasks_[k].parts) {
      if (!terms[part.term]->bends()) continue;
      terms[part.term]->add_curvature(rate, dt, least, curvature);
      curved_[k] = curvature;
    }
  }
}

// Add X of the tasks that no cost draws to that of their level.
void Levels::bound_exact(std::size_t k, const std::vector<std::unique_ptr<RowTerm>>& terms,
                         const double* rate, const Manner& manner) {
  const std::size_t n = dofs_.size();
  double* bound = exact_curvature_.data() + k * n;
  std::fill_n(bound, n, 0.0);
  if (curved_[k] != nullptr) std::copy_n(curved_[k], n, bound);
  for (const LevelTasks::Part& part : tasks_[k].parts) {
    if (!terms[part.term]->exact()) continue;
    terms[part.term]->add_curvature(rate, manner.dt, manner.least, bound);
  }
  levels_[k].curvature = bound;
}

void Levels::gather(const LevelTasks& tasks, const std::vector<std::unique_ptr<RowTerm>>& terms,
                    const Stack& stack, const double* rate, Level& level) {
  const int n = static_cast<int>(dofs_.size());
  double* matrix = matrix_.data() + (level.matrix - matrix_.data());
  double* wanted = rate_.data() + (level.rate - rate_.data());
  double* jacobian = jacobian_.data() + (level.jacobian - jacobian_.data());
  double* direction = direction_.data() + (level.direction - direction_.data());
  for (const LevelTasks::Part& part : tasks.parts) {
    const RowTerm& term = *terms[part.term];
    const int first = term.data().first;
    for (int r = 0; r < term.data().rows; ++r, matrix += n) {
      std::fill_n(matrix, n, 0.0);
      if (tasks.hard) {
        *wanted++ = term.exact_row(r, rate, matrix);
        continue;
      }
      term.copy_row(r, matrix);
      *wanted++ = term.weighed(r, rate + first);
    }
    for (const int r : part.directed) {
      const double* own = stack.jacobian + (first + r) * nv_;
      for (int i = 0; i < n; ++i) *jacobian++ = own[dofs_[i]];
      *direction++ = rate[first + r];
    }
  }
  for (const LevelTasks::JointPart& part : tasks.joints) {
    const int rows = static_cast<int>(part.root.size()) / nv_;
    for (int r = 0; r < rows; ++r) {
      const double* root = part.root.data() + r * nv_;
      for (int i = 0; i < n; ++i) *matrix++ = root[dofs_[i]];
      *wanted++ = dot(root, rate + part.first, nv_);
    }
  }
}

void Levels::write_metric(const double* inertia, double damping) {
  const int n = static_cast<int>(dofs_.size());
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      double value = metric_.constant[i * n + j];
      if (metric_.inertia != 0.0) value += metric_.inertia * inertia[dofs_[i] * nv_ + dofs_[j]];
      last_[i * n + j] = value;
    }
    last_[i * n + i] += damping;
  }
}

}  // namespace rmrc
