#include "engine/shorten.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <numeric>
#include <utility>

#include "base/lie.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.engine.backtracking: TOLERANCE, NOISE, MOST_LOOKS and MOST_PARTS.
constexpr double tolerance = 0.5;
constexpr double noise = 1e-3;
constexpr int most_looks = 256;
constexpr int most_parts = 24;
constexpr int most_ahead = 56;  // parts of parts, more than log₂ of most_steps of path.cpp

}  // namespace

Shortening::Shortening(const Rows& rows, const Kinematics& own, const double* twist, int mocaps)
    : rows_(rows),
      slides_(rows.slides()),
      tolerance_(tolerance * rows.resolution()),
      noise_(noise * rows.resolution()),
      mujoco_(rows.mujoco()),
      own_(own),
      twist_(twist),
      mocaps_(mocaps),
      n_(static_cast<int>(rows.dofs().size())),
      path_(rows.limits()),
      command_(n_),
      step_(mujoco_.nv),
      fast_(mujoco_.nv),
      change_(mujoco_.nv),
      bent_(mujoco_.nv),
      moved_(mujoco_.nv),
      entries_(rows.capacity()),
      all_(rows.capacity()),
      some_(rows.capacity()),
      ahead_(most_ahead) {
  for (const Block& block : rows.blocks()) {
    pairs_.push_back(dynamic_cast<const Collision*>(block.barrier));
  }
  std::iota(all_.begin(), all_.end(), 0);
  const auto allocate = [&](Look& look) {
    look.way.resize(n_);
    look.room.resize(rows.capacity());
    look.known.resize(rows.capacity());
  };
  allocate(begin_);
  for (Part& part : ahead_) {
    allocate(part.look);
    part.among.resize(rows.capacity());
  }
}

// Find the entries that a motion with v, or with any share between it and the brake if there is one,
// could carry below their limit.
void Shortening::follow(ForwardKinematics& kinematics) {
  if (mujoco_.moving == nullptr) throw std::invalid_argument("what moves of the model is not known");
  kinematics.require(rows_.poses_ahead(own_), *mujoco_.moving);
  kinematics_ = &kinematics;
}

void Shortening::watch(const double* v, const double* brake, double dt) {
  dt_ = dt;
  std::fill(step_.begin(), step_.end(), 0.0);
  for (int i = 0; i < n_; ++i) {
    command_[i] = brake == nullptr ? v[i] : std::max(std::abs(v[i]), std::abs(brake[i]));
  }
  path_.set_out(command_.data(), dt, brake == nullptr ? rows_.now().qpos : nullptr);
  double* way = ahead_[0].look.way.data();
  path_.way(path_.last(), way);
  for (int i = 0; i < n_; ++i) step_[rows_.dofs()[i]] = std::abs(way[i]);
  slides_.begin(rows_.now().qpos, step_.data());
  slides_.stretch(step_.data(), dt);
  count_ = 0;
  for (std::size_t k = 0; k < rows_.blocks().size(); ++k) {
    const Block& block = rows_.blocks()[k];
    for (int row = block.first; row < block.first + block.count; ++row) {
      const int id = static_cast<int>(rows_.arrays().ids[row]);
      const double reach = block.barrier->reach(id, step_.data(), dt_);
      const double distance = rows_.arrays().distance[row];
      if (!(distance < reach)) continue;
      Entry& entry = entries_[count_++];
      entry.barrier = block.barrier;
      entry.pairs = pairs_[k];
      entry.id = id;
      entry.floor = std::min(distance - noise_, -tolerance_);
      entry.reach = reach;
      entry.now = distance;
      if (entry.pairs != nullptr) {
        entry.plane = entry.pairs->plane(rows_.now(), id);
        entry.now = entry.plane.distance;
      }
      entry.now -= entry.floor;
    }
  }
}

// Whether no look on the path to rest, which is halved until each part is known to be free, finds
// a room below `least`; the first that does is kept. What the clock cuts short is not known to be
// free either.
bool Shortening::worst(double least) {
  Look& end = ahead_[0].look;
  look(path_.last(), all_.data(), count_, end);
  if (is_short(end, least)) return false;
  Part& whole = ahead_[0];
  whole.count = count_;
  std::copy_n(all_.begin(), count_, whole.among.begin());
  if (still_ && (path_.slows() || path_.last() == 1.0)) {
    begin_.place = 0.0;
    std::fill(begin_.way.begin(), begin_.way.end(), 0.0);
    for (int k = 0; k < count_; ++k) begin_.room[k] = begin_.known[k] = entries_[k].now;
    whole.count = doubtful(begin_, end, all_.data(), count_, whole.among.data());
    if (whole.count == 0) return true;
  }
  const int cuts = parts();
  for (int k = 1; k < cuts; ++k) {
    if (is_over(end_)) return false;
    look(static_cast<double>(k) / cuts, whole.among.data(), whole.count, begin_);
    if (is_short(begin_, least)) return false;
  }
  if (path_.last() == 1.0) return true;
  if (is_over(end_)) return false;
  look(1.0, whole.among.data(), whole.count, begin_);
  return !is_short(begin_, least) && halved(least);
}

// The same between the end of the step and rest, from the first part on. After so many looks what
// is not known to be free counts as passed.
bool Shortening::halved(double least) {
  int top = 0, looks = 0;
  while (top >= 0) {
    Part& part = ahead_[top];
    const double steps = part.look.place - begin_.place;
    int doubts = 0;
    if (steps > 1.0) {
      doubts = doubtful(begin_, part.look, part.among.data(), part.count, some_.data());
    }
    if (doubts == 0) {
      std::swap(begin_, part.look);
      --top;
      continue;
    }
    if (is_over(end_)) return false;
    Part& half = ahead_[++top];
    std::copy_n(some_.begin(), doubts, part.among.begin());
    std::copy_n(some_.begin(), doubts, half.among.begin());
    part.count = half.count = doubts;
    look(begin_.place + std::floor(0.5 * steps), some_.data(), doubts, half.look);
    if (++looks > most_looks && half.look.least >= least) half.look.least = -infinity;
    if (is_short(half.look, least)) return false;
  }
  return true;
}

// Whether a look has found too little room, and is kept for it.
bool Shortening::is_short(const Look& look, double least) {
  if (!(look.least < least)) return false;
  found_ = {look.place, look.least, entries_[look.worst]};
  return true;
}

// Return into how many parts to cut the step, so that nothing is passed through.
int Shortening::parts() {
  const Part& whole = ahead_[0];
  std::fill(step_.begin(), step_.end(), 0.0);
  for (int i = 0; i < n_; ++i) step_[rows_.dofs()[i]] = path_.first(i);
  slides_.stretch(step_.data(), dt_);
  double passes = 1.0;
  for (int k = 0; k < whole.count; ++k) {
    const Entry& entry = entries_[whole.among[k]];
    const double fall = entry.barrier->reach(entry.id, step_.data(), dt_);
    passes = std::max(passes, fall / entry.barrier->thickness(entry.id));
  }
  return static_cast<int>(std::min(std::ceil(passes), static_cast<double>(most_parts)));
}

// Find which entries could fall below what is allowed between two looks. In a time T a motion with
// the acceleration a leaves its chord by no more than a T²/8.
int Shortening::doubtful(const Look& before, const Look& after, const int* among, int count,
                         int* found) {
  for (auto* values : {&step_, &fast_, &change_, &bent_}) {
    std::fill(values->begin(), values->end(), 0.0);
  }
  const std::vector<bool>& turning = rows_.turning();
  double turn = 0.0;
  for (int i = 0; i < n_; ++i) {
    const int dof = rows_.dofs()[i];
    step_[dof] = std::abs(after.way[i] - before.way[i]);
    fast_[dof] = path_.speed(i, before.place);
    change_[dof] = path_.turn(i, before.place);
    if (turning[dof]) turn += fast_[dof];
  }
  for (const int dof : rows_.dofs()) {
    bent_[dof] = change_[dof] + (turning[dof] ? turn : 2.0 * turn) * fast_[dof];
  }
  for (auto* values : {&step_, &fast_, &change_, &bent_}) slides_.stretch(values->data(), 0.0);
  const double time = (after.place - before.place) * dt_;
  int doubts = 0;
  for (int k = 0; k < count; ++k) {
    const int at = among[k];
    const Entry& entry = entries_[at];
    double reach, bend;
    if (entry.pairs != nullptr) {
      reach = entry.pairs->fall(entry.id, step_.data());
      bend = entry.pairs->bend(entry.id, entry.reach, fast_.data(), change_.data());
    } else {
      reach = entry.barrier->reach(entry.id, step_.data(), 0.0);
      bend = entry.barrier->reach(entry.id, bent_.data(), 0.0);
    }
    const double known = std::min(before.known[at], after.known[at]);
    const bool free = known >= bend * (time * time / 8.0) ||
                      before.room[at] + after.room[at] >= reach;
    if (!free) found[doubts++] = at;
  }
  return doubts;
}

// Look at some entries, and measure those not known to have room.
void Shortening::look(double place, const int* among, int count, Look& look) {
  look.place = place;
  look.least = infinity;
  path_.way(place, look.way.data());
  put(look.way.data());
  for (int k = 0; k < count; ++k) {
    const int at = among[k];
    const Entry& entry = entries_[at];
    const bool of_pairs = entry.pairs != nullptr;
    double known = of_pairs ? entry.pairs->least(own_, entry.id, entry.plane)
                          : entry.barrier->distance(own_, entry.id);
    known -= entry.floor;
    double room = known;
    if (of_pairs && !(known >= 0.0)) room = entry.barrier->distance(own_, entry.id) - entry.floor;
    look.known[at] = known;
    look.room[at] = room;
    if (room >= look.least) continue;
    look.least = std::isnan(room) ? -infinity : room;
    look.worst = at;
  }
}

// Run the kinematics after a way (n,) of the joints.
void Shortening::put(const double* way) {
  for (int i = 0; i < n_; ++i) moved_[rows_.dofs()[i]] = way[i];
  std::copy_n(rows_.now().qpos, mujoco_.nq, own_.qpos);
  mujoco_.call.integrate_pos(mujoco_.model, own_.qpos, moved_.data(), 1.0);
  if (kinematics_ != nullptr) {
    kinematics_->update(own_.qpos);
  } else {
    mujoco_.call.kinematics(mujoco_.model, own_.data);
  }
}

// Put the mocap bodies where they will be at the end of the step.
void Shortening::move_obstacles(double dt) {
  for (int k = 0; k < mocaps_; ++k) {
    const double *twist = twist_ + 6 * k, *rate = twist + 3;
    const double* turn = rows_.now().mocap_quat + 4 * k;
    for (int i = 0; i < 3; ++i) {
      own_.mocap_pos[3 * k + i] = rows_.now().mocap_pos[3 * k + i] + dt * twist[i];
    }
    // exp(½ ω dt) q: the rate is along the world's axes.
    const double speed = norm3(rate), half = 0.5 * speed * dt;
    const double sine = speed > 0.0 ? std::sin(half) / speed : 0.0;
    const double left[4] = {std::cos(half), sine * rate[0], sine * rate[1], sine * rate[2]};
    const double back[4] = {turn[0], -turn[1], -turn[2], -turn[3]};
    multiply_conjugate(left, back, own_.mocap_quat + 4 * k);
  }
}

}  // namespace rmrc
