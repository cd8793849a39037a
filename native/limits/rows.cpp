#include "limits/rows.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "base/kernels.hpp"
#include "base/numbers.hpp"

namespace rmrc {

namespace {

// rmrc.qp.rows: ROUNDING and FASTEST.
constexpr double rounding = 1e-9;
constexpr double fastest = 1e6;

constexpr std::int64_t most_of_one = 4;  // rows of one entry

}  // namespace

Rows::Rows(const MuJoCo& mujoco, const Kinematics& now, std::vector<int> dofs,
           std::vector<int> place, const JointLimits& limits, const double* v_previous,
           const RowArrays& arrays, int capacity)
    : mujoco_(mujoco),
      now_(now),
      dofs_(std::move(dofs)),
      place_(std::move(place)),
      limits_(&limits),
      v_previous_(v_previous),
      arrays_(arrays),
      capacity_(capacity),
      turning_(mujoco.nv, true),
      travel_(mujoco.nv),
      low_(dofs_.size()),
      high_(dofs_.size()),
      before_(dofs_.size()),
      brake_(dofs_.size()),
      keys_(capacity) {}

void Rows::know(double resolution, std::vector<bool> turning, Slides slides) {
  resolution_ = resolution;
  turning_ = std::move(turning);
  slides_ = std::move(slides);
}

void Rows::add(SpeedRows speed) {
  room_ += speed.count();
  if (room_ > capacity_) throw std::invalid_argument("there is no room for so many rows");
  speed_count_ += speed.count();
  speeds_.push_back(std::move(speed));
}

void Rows::add(std::unique_ptr<Barrier> barrier) {
  room_ += barrier->size() + barrier->most_kept();
  if (room_ > capacity_) throw std::invalid_argument("there is no room for so many rows");
  blocks_.push_back({barrier.get(), 0, 0});
  kept_blocks_.push_back({barrier.get(), 0, 0});
  barriers_.push_back(std::move(barrier));
}

Poses Rows::poses() const {
  Reads reads;
  for (const SpeedRows& speed : speeds_) reads.add(speed.frame());
  Poses all = reads.poses();
  for (const auto& barrier : barriers_) barrier->read(now_, false, all);
  return all;
}

Poses Rows::poses_ahead(const Kinematics& there) const {
  Poses all;
  for (const auto& barrier : barriers_) barrier->read(there, true, all);
  return all;
}

void Rows::update(const double* lb, const double* ub, double dt) {
  const int n = static_cast<int>(dofs_.size());
  count_ = 0;
  passed_ = false;
  for (SpeedRows& speed : speeds_) {
    speed.write(arrays_.matrix + static_cast<long>(count_) * n, arrays_.upper + count_);
    for (int i = 0; i < speed.count(); ++i, ++count_) {
      arrays_.lower[count_] = -infinity;
      arrays_.ids[count_] = keys_[count_] = count_;
    }
  }
  limit(lb, ub, dt);
  slides_.begin(now_.qpos, travel_.data());
  slides_.stretch(travel_.data(), dt);
  for (std::size_t k = 0; k < blocks_.size(); ++k) {
    add_block(static_cast<std::int64_t>(k), dt);
    add_kept(static_cast<std::int64_t>(k), dt);
  }
}

void Rows::forget() {
  for (const auto& barrier : barriers_) barrier->forget();
}

bool Rows::cut(const double* v, double* H, const double* plain) {
  const long n = static_cast<long>(dofs_.size());
  bool changed = false;
  long first = 0;
  for (SpeedRows& speed : speeds_) {
    const double* y = H == nullptr ? nullptr : arrays_.multiplier + first;
    changed |= speed.cut(v, y, arrays_.matrix + first * n, arrays_.upper + first);
    first += speed.count();
  }
  if (!changed || H == nullptr) return changed;
  std::copy_n(plain, n * n, H);
  for (const SpeedRows& speed : speeds_) speed.bend(H);
  return true;
}

double Rows::excess(const double* v) const {
  double worst = -infinity;
  for (const SpeedRows& speed : speeds_) worst = std::max(worst, speed.excess(v));
  return worst;
}

double Rows::share_of_speeds(const double* brake, const double* v) const {
  double share = 1.0;
  for (const SpeedRows& speed : speeds_) share = std::min(share, speed.share(brake, v));
  return share;
}

void Rows::keep(Memory& memory) {
  for (const auto& barrier : barriers_) barrier->keep(memory);
}

// Bound how fast the joints can be, and how far they can go until they rest.
void Rows::limit(const double* lb, const double* ub, double dt) {
  std::fill(travel_.begin(), travel_.end(), 0.0);
  double most = 0.0;
  longest_ = most_ = 0.0;
  for (std::size_t k = 0; k < dofs_.size(); ++k) {
    // Without a limit 0 · ∞ would be no number, and no joint goes further than around.
    low_[k] = std::max(lb[k], -fastest);
    high_[k] = std::min(ub[k], fastest);
    before_[k] = v_previous_[dofs_[k]];
    const double change = limits_->acceleration[k] * dt, steps = std::abs(before_[k]) / change;
    most = std::max(most, std::max(std::abs(low_[k]), std::abs(high_[k])) / change);
    longest_ = std::max(longest_, steps);
    const double speed = limits_->velocity[k] < fastest ? limits_->velocity[k] : 0.0;
    most_ = std::max(most_, std::max(std::abs(before_[k]), speed) / change);
  }
  braked(*limits_, before_.data(), dt, now_.qpos, brake_.data());
  for (std::size_t k = 0; k < dofs_.size(); ++k) {
    const double speed = std::max(std::abs(low_[k]), std::abs(high_[k])) * dt;
    const bool slows = std::isfinite(limits_->acceleration[k]);
    travel_[dofs_[k]] = slows ? speed * (1.0 + 0.5 * most) : speed;
    brake_[k] = std::min(std::max(brake_[k], low_[k]), high_[k]);
  }
}

void Rows::add_block(std::int64_t which, double dt) {
  Block& block = blocks_[which];
  Near near = free();
  block.barrier->near(now_, travel_.data(), dt, near);
  add_rows(block, near.count, (which + 1) << 32, dt);
  for (int row = block.first; row < count_; ++row) {
    passed_ |= arrays_.distance[row] < -resolution_;
  }
}

void Rows::add_kept(std::int64_t which, double dt) {
  Block& block = kept_blocks_[which];
  Near near = free();
  near.count = 0;
  if (blocks_[which].count > 0) block.barrier->kept(now_, near);
  add_rows(block, near.count, ((which + 1) << 32) + (std::int64_t{1} << 31), dt);
}

// Return where the next rows can stand.
Near Rows::free() {
  return {arrays_.ids + count_, arrays_.distance + count_,
          arrays_.slope + static_cast<long>(count_) * mujoco_.nv, arrays_.drift + count_, 0};
}

// Write the rows of what a barrier has written, known by the key on and, of those of one entry, one
// after another.
void Rows::add_rows(Block& block, int count, std::int64_t key, double dt) {
  const int n = static_cast<int>(dofs_.size()), nv = mujoco_.nv;
  block.first = count_;
  block.count = count;
  count_ += count;
  for (int row = block.first; row < count_; ++row) {
    keys_[row] = key + most_of_one * arrays_.ids[row];
    if (row > block.first) keys_[row] = std::max(keys_[row], keys_[row - 1] + 1);
    const double* slope = arrays_.slope + static_cast<long>(row) * nv;
    double* columns = arrays_.matrix + static_cast<long>(row) * n;
    for (int k = 0; k < n; ++k) columns[k] = slope[dofs_[k]];
    arrays_.lower[row] = bounded(row, lower(*block.barrier, row, dt));
    arrays_.upper[row] = infinity;
  }
}

// Return what slope·v must at least be.
double Rows::lower(const Barrier& barrier, int row, double dt) const {
  const double distance = arrays_.distance[row], room = barrier.gain() * distance;
  const double rate = distance >= 0.0 ? stopping(row, room, dt) : room / dt;
  return std::min(-rate, barrier.push()) - arrays_.drift[row];
}

// Return the speed from which the distance of a row can still be stopped in a room.
double Rows::stopping(int row, double room, double dt) const {
  const double steps = longest_ > 0.0 || arrays_.drift[row] < 0.0 ? most_ : 0.0;
  const double any = room * 2.0 / ((steps + 2.0) * dt);
  if (!(longest_ > 0.0)) return any;
  const int n = static_cast<int>(dofs_.size());
  const double* slope = arrays_.matrix + static_cast<long>(row) * n;
  const double slower = std::max(-dot(slope, before_.data(), n), 0.0) / longest_;
  const double reach = 2.0 * room * (slower / dt);
  const double root = std::sqrt(slower * slower + reach) + slower;
  return std::max(any, root > 0.0 ? reach / root : 0.0);
}

// Return what a row must at least be once it is lowered to what the box allows. No row that only
// holds an approach back asks for more than the brake can do.
double Rows::bounded(int row, double lower) const {
  const int n = static_cast<int>(dofs_.size());
  const double* columns = arrays_.matrix + static_cast<long>(row) * n;
  double least = 0.0, most = 0.0;
  for (int k = 0; k < n; ++k) {
    least += columns[k] * brake_[k];
    most += std::max(columns[k] * low_[k], columns[k] * high_[k]);
  }
  if (lower <= 0.0) lower = std::min(lower, least - rounding * std::abs(least));
  return std::min(lower, most - rounding * std::abs(most));
}

}  // namespace rmrc
