#include "control/stepper.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "control/inputs.hpp"
#include "control/status.hpp"

namespace rmrc {

namespace {

constexpr double active_multiplier = 1e-7;  // rmrc.control.status.ACTIVE_MULTIPLIER
constexpr double elsewhere = 10.0;          // rmrc.limits.contacts.ELSEWHERE

}  // namespace

Stepper::Stepper(Engine& engine, Progress progress, ControllerState state,
                 std::vector<int> quaternions, std::vector<char> frozen, double budget,
                 std::vector<KeptArray> kept, KeptFlags moving)
    : engine_(engine),
      progress_(std::move(progress)),
      state_(state),
      quaternions_(std::move(quaternions)),
      frozen_(std::move(frozen)),
      budget_(budget),
      kept_(std::move(kept)),
      moving_(moving),
      size_(moving.size + v_begins + 2 * (engine.mujoco().nv + engine.mujoco().nq) +
            engine.size()),
      from_(engine.mujoco().nq),
      before_(engine.size()),
      left_(engine.size()) {
  for (const KeptArray& array : kept_) size_ += array.size;
}

bool Stepper::read(const double* q) {
  const int nq = engine_.mujoco().nq;
  bool sane = true;
  for (int i = 0; i < nq; ++i) {
    sane &= std::abs(q[i]) < largest_input;  // NaN is not less
    from_[i] = q[i];
  }
  for (const int first : quaternions_) sane &= normalize(from_.data() + first);
  return sane;
}

// Whether q is farther from where the last command led than the joints can have moved since.
bool Stepper::is_elsewhere(double dt) const {
  double farthest = 0.0, fastest = 0.0;
  for (int i = 0; i < engine_.mujoco().nq; ++i) {
    farthest = std::max(farthest, std::abs(from_[i] - state_.q[i]));
  }
  for (const double velocity : engine_.joint_limits().velocity) fastest = std::max(fastest, velocity);
  return farthest > elsewhere * fastest * dt;
}

bool Stepper::step(const double* q, double dt, Summary& summary) {
  const MuJoCo& mujoco = engine_.mujoco();
  if (q == nullptr) {
    std::copy_n(state_.q, mujoco.nq, from_.begin());
  } else if (!read(q)) {
    return false;
  } else if (is_elsewhere(dt)) {
    engine_.forget_rows();
  }
  std::copy_n(state_.v, mujoco.nv, state_.v_previous);
  const SolveStatus ending = engine_.solve(from_.data(), dt, budget_);
  progress_.update(engine_, engine_.v(), dt);
  summary = {flags(ending), ending, engine_.iterations()};
  dt_ = dt;
  std::fill_n(state_.v, mujoco.nv, 0.0);
  for (int i = 0; i < engine_.size(); ++i) state_.v[engine_.dofs()[i]] = engine_.v()[i];
  std::copy(from_.begin(), from_.end(), state_.q);
  carry_out(dt);
  return true;
}

void Stepper::brake(double dt) {
  std::copy_n(state_.v, engine_.mujoco().nv, state_.v_previous);
  std::fill_n(state_.v, engine_.mujoco().nv, 0.0);
  const JointLimits& limits = engine_.joint_limits();
  for (int i = 0; i < engine_.size(); ++i) before_[i] = state_.v_previous[engine_.dofs()[i]];
  braked(limits, before_.data(), dt, state_.q, left_.data());
  for (int i = 0; i < engine_.size(); ++i) {
    // What is faster than it may be sheds all that it can, not only its part.
    const double fastest =
        std::max(limits.velocity[i], std::abs(before_[i]) - limits.acceleration[i] * dt);
    state_.v[engine_.dofs()[i]] = std::min(std::max(left_[i], -fastest), fastest);
  }
  progress_.reset();
  carry_out(dt);
}

void Stepper::carry_out(double dt) {
  const MuJoCo& mujoco = engine_.mujoco();
  mujoco.call.integrate_pos(mujoco.model, state_.q, state_.v, dt);
}

void Stepper::reset(const double* q, const double* v) {
  std::copy_n(q, engine_.mujoco().nq, state_.q);
  std::copy_n(v, engine_.mujoco().nv, state_.v);
  progress_.reset();
  engine_.forget();
  engine_.forget_rows();
}

void Stepper::keep(Memory& memory) {
  memory(state_.q, engine_.mujoco().nq);  // first: a batch reads it there
  memory(state_.v, engine_.mujoco().nv);
  progress_.keep(memory);
  engine_.keep(memory);
}

int Stepper::size() const {
  const Rows* rows = engine_.limits();
  const Equalities* held = engine_.equalities();
  const int count = held == nullptr ? size_ : size_ + held->count();
  return rows == nullptr ? count
                         : count + static_cast<int>(rows->blocks().size()) + 4 * rows->count();
}

void Stepper::write(double* out) const {
  const int nq = engine_.mujoco().nq, nv = engine_.mujoco().nv;
  const Residuals& kkt = engine_.residuals();
  for (const double value :
       {kkt.primal, kkt.dual, kkt.complementarity, dt_, engine_.share()}) {
    *out++ = value;
  }
  out = std::copy_n(state_.v, nv, out);
  out = std::copy_n(state_.q, nq, out);
  out = std::copy_n(from_.data(), nq, out);
  out = std::copy_n(state_.v_previous, nv, out);
  out = std::copy_n(engine_.bound_multiplier(), engine_.size(), out);
  for (const KeptArray& array : kept_) out = std::copy_n(array.values, array.size, out);
  out = std::copy_n(moving_.values, moving_.size, out);
  if (const Rows* rows = engine_.limits()) {
    for (std::size_t k = 0; k < rows->blocks().size(); ++k) {
      *out++ = rows->blocks()[k].count + rows->kept_blocks()[k].count;
    }
    out = std::copy_n(rows->arrays().ids, rows->count(), out);
    for (const double* values :
         {rows->arrays().lower, rows->arrays().upper, rows->arrays().multiplier}) {
      out = std::copy_n(values, rows->count(), out);
    }
  }
  if (const Equalities* held = engine_.equalities()) {
    std::copy_n(held->arrays().multiplier, held->count(), out);
  }
}

unsigned Stepper::flags(SolveStatus ending) const {
  unsigned found = 0;
  if (ending == SolveStatus::time_limit) {
    found |= status::deadline;
  } else if (ending != SolveStatus::solved) {
    found |= status::max_iter;
  }
  if (!engine_.in_time()) found |= status::deadline;
  if (engine_.outside()) found |= status::recovering;
  if (engine_.relaxed()) found |= status::relaxed;
  if (engine_.scaled()) found |= status::scaled;
  if (engine_.damped()) found |= status::damped;
  if (progress_.stuck()) found |= status::stuck;
  double square = 0.0;
  for (int i = 0; i < engine_.size(); ++i) {
    const double z = engine_.bound_multiplier()[i];
    if (!frozen_[i]) square += z * z;  // a frozen joint is no limit that is in the way
  }
  if (const Rows* rows = engine_.limits()) {
    const double* y = rows->arrays().multiplier;
    for (int r = 0; r < rows->count(); ++r) square += y[r] * y[r];
  }
  if (square > active_multiplier * active_multiplier || engine_.share() < 1.0) found |= status::limited;
  if (engine_.relaxed()) found |= status::relaxed;
  return found;
}

}  // namespace rmrc
