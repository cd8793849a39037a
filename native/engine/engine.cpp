#include "engine/engine.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "base/kernels.hpp"
#include "base/numbers.hpp"
#include "solver/tolerances.hpp"

namespace rmrc {

namespace {

constexpr double raised = 1e-6;     // rmrc.qp.damping.RAISED

}  // namespace

Engine::Engine(const MuJoCo& mujoco, const Stack& stack, const ProgramArrays& program,
               Constants constants, JointLimits limits, int max_iterations)
    : mujoco_(mujoco),
      stack_(stack),
      program_(program),
      constants_(std::move(constants)),
      box_(std::move(limits)),
      braking_(box_.limits()),
      max_iterations_(max_iterations),
      solver_(static_cast<int>(constants_.dofs.size()), 0, 0, max_iterations),
      v_(constants_.dofs.size()),
      z_(constants_.dofs.size()),
      residual_(constants_.dofs.size()),
      gradient_(mujoco.nv),
      curvature_(constants_.dofs.size()),
      exact_(constants_.dofs.size()),
      v_previous_(constants_.dofs.size()),
      a_previous_(constants_.dofs.size()),
      planned_(constants_.dofs.size()),
      least_norm_(constants_.dofs.size()) {
  brake_.resize(v_.size());
}

void Engine::add(std::unique_ptr<RowTerm> term) {
  require_placed(term->poses());
  rows_.push_back(std::move(term));
}

void Engine::follow(ForwardKinematics& kinematics) {
  kinematics_ = &kinematics;
  for (const auto& term : rows_) require_placed(term->poses());
  if (limits_ != nullptr) require_placed(limits_->poses());
}

void Engine::require_placed(const Poses& poses) const {
  if (kinematics_ == nullptr) return;
  if (mujoco_.moving == nullptr) throw std::invalid_argument("what moves of the model is not known");
  kinematics_->require(poses, *mujoco_.moving);
}

void Engine::add(std::unique_ptr<ForeignRows> term) {
  foreign_.push_back(term.get());
  rows_.push_back(std::move(term));
}

void Engine::adapt(DampingRule rule, std::vector<TaskedRow> rows) {
  damping_.emplace(rule, std::move(rows), size());
}

void Engine::limit(Rows& limits, Shortening* shortening) {
  require_placed(limits.poses());
  limits_ = &limits;
  shortening_ = shortening;
  correction_.emplace(limits);
  for (auto* values : {&whole_, &shortened_, &first_z_}) values->resize(v_.size());
  for (auto* values : {&first_y_, &lower_, &upper_}) values->resize(limits.capacity());
  if (limits.speed_count() > 0) plain_.resize(v_.size() * v_.size());
  renew_solver();
}

void Engine::hold(std::unique_ptr<Equalities> equalities) {
  equalities_ = std::move(equalities);
  for (auto* values : {&first_w_, &right_}) values->resize(equalities_->capacity());
  renew_solver();
}

void Engine::descend(std::vector<LevelTasks> levels, LastMetric metric) {
  LevelTasks hard;
  hard.hard = true;
  for (int k = 0; k < static_cast<int>(rows_.size()); ++k) {
    if (rows_[k]->is_hard()) hard.parts.push_back({k, {}});
  }
  if (!hard.parts.empty()) levels.insert(levels.begin(), std::move(hard));
  levels_ = std::make_unique<Levels>(std::move(levels), std::move(metric), constants_.dofs,
                                     mujoco_.nv, rows_);
  cascade_ = std::make_unique<Cascade>(
      size(), levels_->sizes(), limits_ == nullptr ? 0 : limits_->capacity(),
      equalities_ == nullptr ? 0 : equalities_->capacity(), max_iterations_);
  const auto rows = static_cast<std::size_t>(levels_->sizes().rows);
  missed_.resize(rows);
  gram_.resize(rows * rows);
  all_rows_.resize(rows);
  std::iota(all_rows_.begin(), all_rows_.end(), 0);
  gram_factor_.emplace(static_cast<int>(rows));
}

bool Engine::scaled() const { return cascade_ != nullptr && cascade_->scale() < 1.0 - whole; }

void Engine::renew_solver() {
  const int rows = limits_ == nullptr ? 0 : limits_->capacity();
  const int equalities = equalities_ == nullptr ? 0 : equalities_->capacity();
  solver_ = QPSolver(size(), rows, equalities, max_iterations_);
  least_.emplace(size(), rows, equalities);
}

void Engine::forget() {
  warm_ = false;
  solver_.forget();
  if (cascade_ != nullptr) cascade_->forget();
}

void Engine::keep(Memory& memory) {
  memory(warm_);
  solver_.keep(memory);
  if (cascade_ != nullptr) cascade_->keep(memory);
  if (limits_ != nullptr) limits_->keep(memory);
}

void Engine::rest_targets() {
  for (const auto& term : rows_) {
    const TermData& data = term->data();
    if (*data.moving == 0) std::fill_n(stack_.feedforward + data.first, data.rows, 0.0);
  }
}

bool Engine::damped() const {
  const double added = *program_.added_damping;
  return added > raised * (constants_.floor + added);
}

SolveStatus Engine::solve(const double* q, double dt, double seconds) {
  end_ = end_after(seconds);
  if (q != nullptr) {
    place(q);
    evaluate_terms();
  }
  assemble(dt);
  if (equalities_ != nullptr) update_equalities();
  if (limits_ != nullptr) limits_->update(program_.lb, program_.ub, dt);
  SolveStatus ending = certified_best();
  while (cuts_ && in_time() && cut()) ending = certified_best();
  slow_down();
  if (softened_ && missed_softly() > inconsistency) relaxed_ = true;
  if (shortening_ != nullptr && limits_->count() > 0) at_distance(dt);
  if (bent_) std::copy(plain_.begin(), plain_.end(), program_.H);
  return ending;
}

// Solve the program; where that fails, return how what the ladder has ends.
SolveStatus Engine::certified_best() {
  const bool warm = warm_ && cascade_ == nullptr;
  const SolveStatus ending = best();
  return trusted(ending) ? ending : descend_ladder(ending, warm);
}

void Engine::evaluate(const double* q) {
  place_all(q);
  if (kinematics_ != nullptr) kinematics_->update(q);
  evaluate_terms();
}

void Engine::place(const double* q) {
  if (kinematics_ == nullptr || constants_.inertia > 0.0) place_all(q);
  if (kinematics_ != nullptr) kinematics_->update(q);
}

void Engine::place_all(const double* q) {
  std::copy_n(q, mujoco_.nq, mujoco_.qpos);
  mujoco_.call.kinematics(mujoco_.model, mujoco_.data);
  mujoco_.call.com_pos(mujoco_.model, mujoco_.data);
}

void Engine::evaluate_terms() {
  for (const auto& term : rows_) term->evaluate();
  for (const JointTerm& term : joints_) term.evaluate(mujoco_, stack_);
}

int Engine::row_count() const { return limits_ == nullptr ? 0 : limits_->count(); }

int Engine::equality_count() const { return equalities_ == nullptr ? 0 : equalities_->count(); }

SolveStatus Engine::best() { return cascade_ == nullptr ? attempt() : solve_levels(); }

// Solve the levels as they stand; the multipliers of equalities stay 0.
SolveStatus Engine::solve_levels() {
  const Program limits = program();
  const double square = constants_.floor + *program_.added_damping;
  const std::vector<Level>* levels = nullptr;
  SolveStatus status = SolveStatus::failed;
  for (const bool directed : {true, false}) {
    levels = &levels_->gather(rows_, stack_, program_.rate, program_.inertia,
                              constants_.unit * square,
                              {directed, softened_, dt_, constants_.least_curvature});
    status = cascade_->solve(*levels, limits, end_);
    if (!turns_back()) break;
  }
  const SolveStatus ending = status;
  iterations_ = cascade_->iterations();
  residuals_ = cascade_->residuals();
  std::copy_n(cascade_->v(), size(), v_.begin());
  if (constants_.brakes && is_still()) spare(*levels);
  std::copy_n(cascade_->bound_multiplier(), size(), z_.begin());
  if (limits_ != nullptr) {
    std::copy_n(cascade_->row_multiplier(), limits.rows, limits_->arrays().multiplier);
  }
  if (equalities_ != nullptr) {
    std::fill_n(equalities_->arrays().multiplier, limits.equalities, 0.0);
  }
  return ending;
}

// Solve the program as it stands, and certify the answer.
SolveStatus Engine::attempt() {
  const int n = size();
  SolveStatus ending = SolveStatus::time_limit;
  iterations_ = 0;
  const Program program = this->program();
  const double* gradient = nullptr;
  double* y = limits_ == nullptr ? nullptr : limits_->arrays().multiplier;
  double* w = equalities_ == nullptr ? nullptr : equalities_->arrays().multiplier;
  if (in_time()) {
    ending = solver_.solve(program, end_);
    iterations_ = solver_.iterations();
    gradient = solver_.gradient();
    std::copy_n(solver_.v(), n, v_.begin());
    std::copy_n(solver_.bound_multiplier(), n, z_.begin());
    if (y != nullptr) std::copy_n(solver_.row_multiplier(), program.rows, y);
    if (w != nullptr) std::copy_n(solver_.equality_multiplier(), program.equalities, w);
  } else {
    std::fill(v_.begin(), v_.end(), 0.0);
    std::fill(z_.begin(), z_.end(), 0.0);
    if (y != nullptr) std::fill_n(y, program.rows, 0.0);
    if (w != nullptr) std::fill_n(w, program.equalities, 0.0);
  }
  residuals_ = certify(n, program, z_.data(), y, w, v_.data(), residual_.data(), gradient);
  // What ran out of time goes on from where it got to.
  warm_ = ending == SolveStatus::solved || ending == SolveStatus::time_limit;
  return ending;
}

bool Engine::trusted(SolveStatus ending) const {
  if (ending != SolveStatus::solved || !(residuals_.primal <= certified)) return false;
  const double largest = std::max(residuals_.dual, residuals_.complementarity);
  const double* g = program_.g;
  return largest <= certified || largest <= certified * std::sqrt(dot(g, g, size()));
}

// Find what braking as the step before has looked at it leaves of the velocity.
void Engine::plan() {
  braked(box_.limits(), v_previous_.data(), dt_, mujoco_.qpos, planned_.data());
}

// Write the point of the box nearest to the next one on the way to rest (n,).
void Engine::brake(double* v) {
  plan();
  bool finite = true;
  for (int i = 0; i < size(); ++i) {
    v[i] = std::min(std::max(planned_[i], program_.lb[i]), program_.ub[i]);
    finite &= std::isfinite(v[i]);
  }
  if (!finite) std::fill_n(v, size(), 0.0);
}

}  // namespace rmrc
