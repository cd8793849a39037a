// The program of a step, at what was evaluated: H and g term by term, and the limits.

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/kernels.hpp"
#include "engine/engine.hpp"

namespace rmrc {

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

}  // namespace rmrc
