#include "engine/engine.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "base/kernels.hpp"

namespace rmrc {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double certified = 1e-6;  // rmrc.engine.python.CERTIFIED
constexpr double raised = 1e-6;     // rmrc.qp.damping.RAISED
constexpr double whole = 1e-6;      // rmrc.qp.cascade.WHOLE
constexpr double inconsistent = 1e-6;  // rmrc.qp.relax.INCONSISTENT

Ending ending_of(Status status) {
  switch (status) {
    case Status::solved:
      return Ending::solved;
    case Status::max_iter:
      return Ending::max_iter;
    case Status::time_limit:
      return Ending::time_limit;
    case Status::infeasible:
      return Ending::infeasible;
    case Status::failed:
      break;
  }
  return Ending::failed;
}

}  // namespace

const char* name_of(Ending ending) {
  switch (ending) {
    case Ending::solved:
      return "solved";
    case Ending::max_iter:
      return "max_iter";
    case Ending::time_limit:
      return "time_limit";
    case Ending::infeasible:
      return "infeasible";
    case Ending::failed:
      break;
  }
  return "failed";
}

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

void Engine::add(std::unique_ptr<ForeignRows> term) {
  foreign_.push_back(term.get());
  rows_.push_back(std::move(term));
}

void Engine::adapt(DampingRule rule, std::vector<TaskedRow> rows) {
  damping_.emplace(rule, std::move(rows), size());
}

void Engine::limit(Rows& limits, Shortening* shortening) {
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

Ending Engine::solve(const double* q, double dt, double seconds) {
  end_ = end_after(seconds);
  if (q != nullptr) {
    place(q);
    evaluate_terms();
  }
  assemble(dt);
  if (equalities_ != nullptr) update_equalities();
  if (limits_ != nullptr) limits_->update(program_.lb, program_.ub, dt);
  Ending ending = certified_best();
  while (cuts_ && in_time() && cut()) ending = certified_best();
  slow_down();
  if (softened_ && missed_softly() > inconsistent) relaxed_ = true;
  if (shortening_ != nullptr && limits_->count() > 0) at_distance(dt);
  if (bent_) std::copy(plain_.begin(), plain_.end(), program_.H);
  return ending;
}

// Solve the program; where that fails, return how what the ladder has ends.
Ending Engine::certified_best() {
  const bool warm = warm_ && cascade_ == nullptr;
  const Ending ending = best();
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

bool Engine::assemble(double dt) {
  dt_ = dt;
  moved_ = boxed_ = relaxed_ = bent_ = false;
  cuts_ = limits_ != nullptr && limits_->speed_count() > 0;
  share_ = 1.0;
  for (ForeignRows* term : foreign_) term->read();
  rates(dt);
  add_terms();
  for (int i = 0; i < size(); ++i) {
    v_previous_[i] = stack_.v_previous[constants_.dofs[i]];
    a_previous_[i] = program_.a_previous[constants_.dofs[i]];
  }
  if (constants_.brakes && braking_.brakes()) brake_in_time();
  outside_ = box_.update(mujoco_.qpos, v_previous_.data(), a_previous_.data(), dt, program_.lb,
                         program_.ub);
  return outside_;
}

void Engine::rates(double dt) {
  for (const auto& term : rows_) rate_of(term->data(), dt);
  for (const JointTerm& term : joints_) rate_of(term.data, dt);
}

// ẋ = K clamp(e) + ẋ_ff; a gain above 1/dt would step past the target.
void Engine::rate_of(const TermData& term, double dt) {
  const double gain = std::min(term.gain, 1.0 / dt);
  const double *error = stack_.error + term.first, *fed = stack_.feedforward + term.first;
  double* rate = program_.rate + term.first;
  for (int i = 0; i < term.rows; ++i) rate[i] = gain * error[i];
  for (const Clamp& clamp : term.clamps) {
    const double* part = error + clamp.first;
    const double length = std::sqrt(dot(part, part, clamp.count));
    if (!(length > clamp.longest)) continue;
    for (int i = 0; i < clamp.count; ++i) rate[clamp.first + i] *= clamp.longest / length;
  }
  for (int i = 0; i < term.rows; ++i) rate[i] += fed[i];
}

void Engine::add_terms() {
  const int n = size();
  double *H = program_.H, *g = program_.g;
  std::copy(constants_.hessian.begin(), constants_.hessian.end(), H);
  std::fill_n(g, n, 0.0);
  for (const auto& term : rows_) term->add_to(H, g, n, program_.rate);
  if (damping_ && damping_->adapts()) {
    const double added = *program_.added_damping = damping_->square(rows_, stack_.error);
    for (int i = 0; i < n; ++i) H[i * n + i] += constants_.unit * added;
  }
  add_curvature();
  add_joints();
  if (constants_.inertia > 0.0) add_inertia();
  for (int i = 0; i < n; ++i) {
    const double* row = H + i * n;
    double* column = H + i;
    for (int j = 0; j < i; ++j, column += n) *column = row[j];
  }
}

// H ← H + X: rmrc.qp.curvature.
void Engine::add_curvature() {
  const int n = size();
  std::fill(curvature_.begin(), curvature_.end(), 0.0);
  for (const auto& term : rows_) {
    if (!term->bends()) continue;
    term->add_curvature(program_.rate, dt_, constants_.least_curvature, curvature_.data());
  }
  for (int i = 0; i < n; ++i) program_.H[i * n + i] += curvature_[i];
  if (levels_ != nullptr) levels_->curve(rows_, program_.rate, dt_, constants_.least_curvature);
}

void Engine::add_joints() {
  if (joints_.empty()) return;
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  for (const JointTerm& term : joints_) term.add_to(gradient_.data(), program_.rate);
  for (int i = 0; i < size(); ++i) program_.g[i] += gradient_[constants_.dofs[i]];
}

void Engine::add_inertia() {
  mujoco_.call.make_inertia(mujoco_.model, mujoco_.data);
  mujoco_.call.full_inertia(mujoco_.model, mujoco_.data, program_.inertia);
  const double share = constants_.unit * constants_.inertia;
  for (int i = 0; i < size(); ++i) {
    const double* row = program_.inertia + constants_.dofs[i] * mujoco_.nv;
    for (int j = 0; j <= i; ++j) program_.H[i * size() + j] += share * row[constants_.dofs[j]];
  }
}

// The program as it stands.
Program Engine::program() const {
  Program program{program_.H, program_.g, program_.lb, program_.ub, nullptr, nullptr,
                  nullptr,    nullptr,    nullptr,     0,           0};
  if (boxed_) return program;
  if (limits_ != nullptr) {
    const RowArrays& rows = limits_->arrays();
    program.C = rows.matrix;
    program.lo = moved_ ? lower_.data() : rows.lower;
    program.hi = moved_ ? upper_.data() : rows.upper;
    program.rows = limits_->count();
    program.keys = limits_->keys();
  }
  if (equalities_ != nullptr) {
    const EqualityArrays& held = equalities_->arrays();
    program.E = held.matrix;
    program.f = moved_ ? right_.data() : held.right;
    program.equalities = equalities_->count();
  }
  return program;
}

int Engine::row_count() const { return limits_ == nullptr ? 0 : limits_->count(); }

int Engine::equality_count() const { return equalities_ == nullptr ? 0 : equalities_->count(); }

// Have limits of the program's own, to be moved.
void Engine::move_limits() {
  if (std::exchange(moved_, true)) return;
  if (limits_ != nullptr) {
    std::copy_n(limits_->arrays().lower, limits_->count(), lower_.begin());
    std::copy_n(limits_->arrays().upper, limits_->count(), upper_.begin());
  }
  if (equalities_ != nullptr) {
    std::copy_n(equalities_->arrays().right, equalities_->count(), right_.begin());
  }
}

Ending Engine::best() { return cascade_ == nullptr ? attempt() : solve_levels(); }

// Solve the levels as they stand; the multipliers of equalities stay 0.
Ending Engine::solve_levels() {
  const Program limits = program();
  const double square = constants_.floor + *program_.added_damping;
  const std::vector<Level>* levels = nullptr;
  Status status = Status::failed;
  for (const bool directed : {true, false}) {
    levels = &levels_->gather(rows_, stack_, program_.rate, program_.inertia,
                              constants_.unit * square,
                              {directed, softened_, dt_, constants_.least_curvature});
    status = cascade_->solve(*levels, limits, end_);
    if (!turns_back()) break;
  }
  const Ending ending = ending_of(status);
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
Ending Engine::attempt() {
  const int n = size();
  Ending ending = Ending::time_limit;
  iterations_ = 0;
  const Program program = this->program();
  const double* gradient = nullptr;
  double* y = limits_ == nullptr ? nullptr : limits_->arrays().multiplier;
  double* w = equalities_ == nullptr ? nullptr : equalities_->arrays().multiplier;
  if (in_time()) {
    ending = ending_of(solver_.solve(program, end_));
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
  warm_ = ending == Ending::solved || ending == Ending::time_limit;
  return ending;
}

bool Engine::trusted(Ending ending) const {
  if (ending != Ending::solved || !(residuals_.primal <= certified)) return false;
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
