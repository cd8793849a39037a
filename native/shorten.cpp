#include "shorten.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "lie.hpp"

namespace rmrc {

namespace {

// rmrc.control.shorten: TOLERANCE, NOISE, MOST_LOOKS and MOST_PARTS.
constexpr double tolerance = 0.5e-6;
constexpr double noise = 1e-9;
constexpr int most_looks = 256;
constexpr int most_parts = 24;
// More than so many entries, or steps to rest, are left to Python.
constexpr int most_entries = 128;
constexpr double most_steps = 1e6;
constexpr int most_ahead = 24;  // > log₂ most_steps

constexpr double infinity = std::numeric_limits<double>::infinity();

}  // namespace

Shortening::Shortening(const Rows& rows, const Kinematics& own, std::vector<double> deceleration,
                       const double* twist, int mocaps)
    : rows_(rows),
      mujoco_(rows.mujoco()),
      own_(own),
      twist_(twist),
      mocaps_(mocaps),
      n_(static_cast<int>(rows.dofs().size())),
      deceleration_(std::move(deceleration)),
      slows_(std::all_of(deceleration_.begin(), deceleration_.end(),
                         [](double a) { return std::isfinite(a); })),
      sign_(n_),
      speed_(n_),
      steps_(n_),
      change_(n_),
      step_(mujoco_.nv),
      fast_(mujoco_.nv),
      turn_(mujoco_.nv),
      bent_(mujoco_.nv),
      moved_(mujoco_.nv),
      entries_(most_entries),
      all_(most_entries),
      some_(most_entries),
      ahead_(most_ahead) {
  for (const Block& block : rows.blocks()) {
    pairs_.push_back(dynamic_cast<const Collision*>(block.barrier));
  }
  std::iota(all_.begin(), all_.end(), 0);
  const auto allocate = [&](Look& look) {
    look.way.resize(n_);
    look.room.resize(most_entries);
    look.known.resize(most_entries);
  };
  allocate(begin_);
  for (Part& part : ahead_) {
    allocate(part.look);
    part.among.resize(most_entries);
  }
}

bool Shortening::free(const double* v, double dt) {
  set_out(v, dt);
  if (!(last_ <= most_steps) || !watch()) return false;
  if (count_ == 0) return true;
  still_ = std::all_of(twist_, twist_ + 6 * mocaps_, [](double rate) { return rate == 0.0; });
  move_obstacles(dt);
  return worst();
}

// Begin the way of a step with v, and of those after it, the ith of which has |v| − i a dt left.
void Shortening::set_out(const double* v, double dt) {
  dt_ = dt;
  last_ = 0.0;
  for (int i = 0; i < n_; ++i) {
    const double change = deceleration_[i] * dt;
    sign_[i] = v[i] > 0.0 ? 1.0 : v[i] < 0.0 ? -1.0 : 0.0;
    speed_[i] = std::abs(v[i]);
    steps_[i] = std::floor(speed_[i] / change);
    change_[i] = change < infinity ? change : 0.0;
    last_ = std::max(last_, steps_[i]);
  }
  last_ += 1.0;
}

// Write how far the joints have moved at a place, counted in steps (n,).
void Shortening::way(double place, double* way) const {
  for (int i = 0; i < n_; ++i) {
    if (place <= 1.0) {
      way[i] = sign_[i] * speed_[i] * (place * dt_);
      continue;
    }
    const double steps = std::min(steps_[i], place - 1.0);
    const double slowed = 0.5 * change_[i] * (steps * (steps + 1.0));
    way[i] = sign_[i] * (((steps + 1.0) * speed_[i] - slowed) * dt_);
  }
}

// Find the entries that the motion could carry below their limit; false if there are too many.
bool Shortening::watch() {
  Look& end = ahead_[0].look;
  way(last_, end.way.data());
  for (int i = 0; i < n_; ++i) step_[rows_.dofs()[i]] = std::abs(end.way[i]);
  count_ = 0;
  for (std::size_t k = 0; k < rows_.blocks().size(); ++k) {
    const Block& block = rows_.blocks()[k];
    for (int row = block.first; row < block.first + block.count; ++row) {
      const int id = static_cast<int>(rows_.arrays().ids[row]);
      const double reach = block.barrier->reach(id, step_.data(), dt_);
      const double distance = rows_.arrays().distance[row];
      if (!(distance < reach)) continue;
      if (count_ == most_entries) return false;
      Entry& entry = entries_[count_++];
      entry.barrier = block.barrier;
      entry.pairs = pairs_[k];
      entry.id = id;
      entry.floor = std::min(distance - noise, -tolerance);
      entry.reach = reach;
      entry.now = distance;
      if (entry.pairs != nullptr) {
        entry.plane = entry.pairs->plane(rows_.now(), id);
        entry.now = entry.plane.distance;
      }
      entry.now -= entry.floor;
    }
  }
  return true;
}

// Whether no look on the path to rest, which is halved until each part is known to be free, finds
// a room below 0.
bool Shortening::worst() {
  Look& end = ahead_[0].look;
  if (!look(last_, all_.data(), count_, end)) return false;
  Part& whole = ahead_[0];
  whole.count = count_;
  std::copy_n(all_.begin(), count_, whole.among.begin());
  if (still_ && (slows_ || last_ == 1.0)) {
    begin_.place = 0.0;
    std::fill(begin_.way.begin(), begin_.way.end(), 0.0);
    for (int k = 0; k < count_; ++k) begin_.room[k] = begin_.known[k] = entries_[k].now;
    whole.count = doubtful(begin_, end, all_.data(), count_, whole.among.data());
    if (whole.count == 0) return true;
  }
  const int cuts = parts();
  for (int k = 1; k < cuts; ++k) {
    const double place = static_cast<double>(k) / cuts;
    if (!look(place, whole.among.data(), whole.count, begin_)) return false;
  }
  if (last_ == 1.0) return true;
  return look(1.0, whole.among.data(), whole.count, begin_) && halved();
}

// The same between the end of the step and rest, from the first part on.
bool Shortening::halved() {
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
    if (++looks > most_looks || top + 1 == most_ahead) return false;
    Part& half = ahead_[++top];
    std::copy_n(some_.begin(), doubts, part.among.begin());
    std::copy_n(some_.begin(), doubts, half.among.begin());
    part.count = half.count = doubts;
    const double between = begin_.place + std::floor(0.5 * steps);
    if (!look(between, some_.data(), doubts, half.look)) return false;
  }
  return true;
}

// Return into how many parts to cut the step, so that nothing is passed through.
int Shortening::parts() {
  const Part& whole = ahead_[0];
  for (int i = 0; i < n_; ++i) step_[rows_.dofs()[i]] = speed_[i] * dt_;
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
  double all = 0.0;
  for (int i = 0; i < n_; ++i) {
    const int dof = rows_.dofs()[i];
    const bool moving = steps_[i] >= before.place;
    step_[dof] = std::abs(after.way[i] - before.way[i]);
    fast_[dof] = moving ? speed_[i] - before.place * change_[i] : 0.0;
    turn_[dof] = moving ? change_[i] / dt_ : 0.0;
    all += fast_[dof];
  }
  for (const int dof : rows_.dofs()) bent_[dof] = turn_[dof] + all * fast_[dof];
  const double time = (after.place - before.place) * dt_;
  int doubts = 0;
  for (int k = 0; k < count; ++k) {
    const int at = among[k];
    const Entry& entry = entries_[at];
    double reach, bend;
    if (entry.pairs != nullptr) {
      reach = entry.pairs->fall(entry.id, step_.data());
      bend = entry.pairs->bend(entry.id, entry.reach, fast_.data(), turn_.data());
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

// Look at some entries, and measure those not known to have room; false if one has none.
bool Shortening::look(double place, const int* among, int count, Look& look) {
  look.place = place;
  way(place, look.way.data());
  put(look.way.data());
  bool all = true;
  for (int k = 0; k < count; ++k) {
    const int at = among[k];
    const Entry& entry = entries_[at];
    const bool planes = entry.pairs != nullptr;
    double known = planes ? entry.pairs->least(own_, entry.id, entry.plane)
                          : entry.barrier->distance(own_, entry.id);
    known -= entry.floor;
    look.known[at] = look.room[at] = known;
    if (planes && !(known >= 0.0)) {
      look.room[at] = entry.barrier->distance(own_, entry.id) - entry.floor;
    }
    all &= look.room[at] >= 0.0;
  }
  return all;
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
    const double speed = std::sqrt(dot3(rate, rate)), half = 0.5 * speed * dt;
    const double sine = speed > 0.0 ? std::sin(half) / speed : 0.0;
    const double left[4] = {std::cos(half), sine * rate[0], sine * rate[1], sine * rate[2]};
    const double back[4] = {turn[0], -turn[1], -turn[2], -turn[3]};
    multiply_conjugate(left, back, own_.mocap_quat + 4 * k);
  }
}

}  // namespace rmrc
