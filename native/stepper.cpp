#include "stepper.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "inputs.hpp"

namespace rmrc {

namespace {

// rmrc.control.step.Status
enum : unsigned {
  limited = 1u << 1,
  damped = 1u << 3,
  recovering = 1u << 4,
  stuck = 1u << 6,
  max_iter = 1u << 7,
  deadline = 1u << 8
};

constexpr double active_multiplier = 1e-7;  // rmrc.control.step.ACTIVE_MULTIPLIER

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
            engine.size()) {
  for (const KeptArray& array : kept_) size_ += array.size;
}

bool Stepper::read(const double* q, double* out) const {
  const int nq = engine_.mujoco().nq;
  bool sane = true;
  for (int i = 0; i < nq; ++i) {
    sane &= std::abs(q[i]) < largest_input;  // NaN is not less
    out[i] = q[i];
  }
  for (const int first : quaternions_) {
    double* turn = out + first;
    const double norm =
        std::sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3]);
    sane &= norm >= zero_norm;
    for (int i = 0; i < 4; ++i) turn[i] /= norm;
  }
  return sane;
}

bool Stepper::step(const double* q, double dt, double* out, Summary& summary) {
  const MuJoCo& mujoco = engine_.mujoco();
  const int nq = mujoco.nq, nv = mujoco.nv, n = engine_.size();
  double *v = out + v_begins, *following = v + nv, *from = following + nq, *previous = from + nq;
  double *z = previous + nv, *rest = z + n;
  if (q == nullptr) {
    std::copy_n(state_.q, nq, from);
  } else if (!read(q, from)) {
    return false;
  }
  std::copy_n(state_.v, nv, previous);
  std::copy_n(state_.v, nv, state_.v_previous);
  const Ending ending = engine_.solve(from, dt, budget_);
  progress_.update(engine_, dt);
  summary = {flags(ending), ending, engine_.iterations()};
  const Residuals& kkt = engine_.residuals();
  out[0] = kkt.primal;
  out[1] = kkt.dual;
  out[2] = kkt.complementarity;
  out[3] = dt;
  std::fill_n(v, nv, 0.0);
  for (int i = 0; i < n; ++i) v[engine_.dofs()[i]] = engine_.v()[i];
  std::copy_n(from, nq, following);
  carry_out(v, following, dt);
  std::copy_n(engine_.bound_multiplier(), n, z);
  for (const KeptArray& array : kept_) rest = std::copy_n(array.values, array.size, rest);
  std::copy_n(moving_.values, moving_.size, rest);
  return true;
}

void Stepper::brake(double dt, double* out) {
  const int nq = engine_.mujoco().nq, nv = engine_.mujoco().nv;
  double *v = out + v_begins, *following = v + nv;
  std::fill_n(v, nv, 0.0);
  for (int i = 0; i < engine_.size(); ++i) {
    const int dof = engine_.dofs()[i];
    const double most = engine_.limits().acceleration[i] * dt;
    v[dof] = state_.v[dof] - std::min(std::max(state_.v[dof], -most), most);
  }
  progress_.reset();
  std::copy_n(state_.q, nq, following);
  carry_out(v, following, dt);
}

// Move q on with v, and remember both.
void Stepper::carry_out(const double* v, double* q, double dt) {
  const MuJoCo& mujoco = engine_.mujoco();
  mujoco.call.integrate_pos(mujoco.model, q, v, dt);
  std::copy_n(q, mujoco.nq, state_.q);
  std::copy_n(v, mujoco.nv, state_.v);
}

void Stepper::reset(const double* q, const double* v) {
  std::copy_n(q, engine_.mujoco().nq, state_.q);
  std::copy_n(v, engine_.mujoco().nv, state_.v);
  progress_.reset();
  engine_.forget();
}

void Stepper::keep(Memory& memory) {
  memory(state_.q, engine_.mujoco().nq);
  memory(state_.v, engine_.mujoco().nv);
  progress_.keep(memory);
  engine_.keep(memory);
}

unsigned Stepper::flags(Ending ending) const {
  unsigned found = 0;
  if (ending == Ending::time_limit) {
    found |= deadline;
  } else if (ending != Ending::solved) {
    found |= max_iter;
  }
  if (!engine_.in_time()) found |= deadline;
  if (engine_.outside()) found |= recovering;
  if (engine_.damped()) found |= damped;
  if (progress_.stuck()) found |= stuck;
  double square = 0.0;
  for (int i = 0; i < engine_.size(); ++i) {
    const double z = engine_.bound_multiplier()[i];
    if (!frozen_[i]) square += z * z;  // a frozen joint is no limit that is in the way
  }
  if (square > active_multiplier * active_multiplier) found |= limited;
  return found;
}

}  // namespace rmrc
