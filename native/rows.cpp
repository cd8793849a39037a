#include "rows.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "kernels.hpp"

namespace rmrc {

namespace {

// rmrc.qp.rows: STOPPING, ROUNDING and FASTEST.
constexpr double counted_on = 0.5;
constexpr double rounding = 1e-9;
constexpr double fastest = 1e6;

constexpr double infinity = std::numeric_limits<double>::infinity();

}  // namespace

Rows::Rows(const MuJoCo& mujoco, const Kinematics& now, std::vector<int> dofs,
           std::vector<int> place, std::vector<double> inverse_acceleration,
           const RowArrays& arrays, int capacity)
    : mujoco_(mujoco),
      now_(now),
      dofs_(std::move(dofs)),
      place_(std::move(place)),
      inverse_acceleration_(std::move(inverse_acceleration)),
      arrays_(arrays),
      capacity_(capacity),
      stops_(std::any_of(inverse_acceleration_.begin(), inverse_acceleration_.end(),
                         [](double value) { return value != 0.0; })),
      turning_(mujoco.nv, true),
      travel_(mujoco.nv),
      low_(dofs_.size()),
      high_(dofs_.size()),
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
  room_ += barrier->size();
  if (room_ > capacity_) throw std::invalid_argument("there is no room for so many rows");
  blocks_.push_back({barrier.get(), 0, 0});
  barriers_.push_back(std::move(barrier));
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
  for (std::size_t k = 0; k < blocks_.size(); ++k) add_block(static_cast<std::int64_t>(k), dt);
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
  for (std::size_t k = 0; k < dofs_.size(); ++k) {
    // Without a limit 0 · ∞ would be no number, and no joint goes further than around.
    low_[k] = std::max(lb[k], -fastest);
    high_[k] = std::min(ub[k], fastest);
    const double speed = std::max(std::abs(low_[k]), std::abs(high_[k]));
    double travel = speed * dt;
    if (stops_) travel += 0.5 * speed * speed * inverse_acceleration_[k];
    travel_[dofs_[k]] = travel;
  }
}

void Rows::add_block(std::int64_t which, double dt) {
  const int n = static_cast<int>(dofs_.size()), nv = mujoco_.nv;
  Block& block = blocks_[which];
  Near near{arrays_.ids + count_, arrays_.distance + count_,
            arrays_.slope + static_cast<long>(count_) * nv, arrays_.drift + count_, 0};
  block.barrier->near(now_, travel_.data(), dt, near);
  block.first = count_;
  block.count = near.count;
  count_ += near.count;
  for (int row = block.first; row < count_; ++row) {
    keys_[row] = ((which + 1) << 32) + arrays_.ids[row];
    const double* slope = arrays_.slope + static_cast<long>(row) * nv;
    double* columns = arrays_.matrix + static_cast<long>(row) * n;
    for (int k = 0; k < n; ++k) columns[k] = slope[dofs_[k]];
    arrays_.lower[row] = lower(*block.barrier, row, dt);
    arrays_.upper[row] = infinity;
    passed_ |= arrays_.distance[row] < -resolution_;
  }
}

// Return what slope·v must at least be.
double Rows::lower(const Barrier& barrier, int row, double dt) const {
  const int n = static_cast<int>(dofs_.size());
  const double* slope = arrays_.matrix + static_cast<long>(row) * n;
  const double distance = arrays_.distance[row];
  double rate = barrier.gain() / dt * distance;
  if (stops_) rate = std::min(rate, stopping(distance, slope, dt));
  double lower = std::min(-rate, barrier.push()) - arrays_.drift[row];
  double braked = 0.0, most = 0.0;
  for (int k = 0; k < n; ++k) {
    braked += slope[k] * std::min(std::max(0.0, low_[k]), high_[k]);
    most += std::max(slope[k] * low_[k], slope[k] * high_[k]);
  }
  // No row that only holds an approach back asks for more than the brake can do.
  if (lower <= 0.0) lower = std::min(lower, braked - rounding * std::abs(braked));
  return std::min(lower, most - rounding * std::abs(most));
}

// Return the speed from which a distance can still be stopped at 0. With joint rates in proportion
// to the slope c, all joints at their a_max take s² Σ |c|³/a / (2 (c·c)²) from a speed s.
double Rows::stopping(double distance, const double* slope, double dt) const {
  double square = 0.0, weight = 0.0;
  for (std::size_t k = 0; k < dofs_.size(); ++k) {
    const double steep = std::abs(slope[k]);
    square += steep * steep;
    weight += steep * steep * steep * inverse_acceleration_[k];
  }
  if (!(weight > 0.0) || distance < 0.0) return infinity;
  const double a = counted_on * (square * square / weight);
  if (!std::isfinite(a)) return infinity;
  const double room = 2.0 * a * distance, change = a * dt;
  const double root = std::sqrt(change * change + room) + change;
  return root > 0.0 ? room / root : 0.0;
}

}  // namespace rmrc
