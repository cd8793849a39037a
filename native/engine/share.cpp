// The search for the share of a command that keeps all distances: Shortening.share of
// rmrc.engine.backtracking.

#include <algorithm>
#include <cmath>

#include "base/numbers.hpp"
#include "engine/shorten.hpp"

namespace rmrc {

namespace {

// rmrc.engine.backtracking: TRIALS, GUESSES, NEARER, LEAST_PART and CLOSE.
constexpr int trials = 10;
constexpr int guesses = 10;
constexpr double nearer = 0.98;
constexpr double least_part = 0.1;
constexpr double close = 0.01;

}  // namespace

Share Shortening::share(const double* v, const double* brake, double dt,
                        Clock::time_point end) {
  end_ = end;
  watch(v, nullptr, dt);
  if (count_ == 0) return {1.0, false};
  still_ = std::all_of(twist_, twist_ + 6 * mocaps_, [](double rate) { return rate == 0.0; });
  move_obstacles(dt);
  if (worst(0.0)) return {1.0, false};
  watch(v, brake, dt);
  double high = 1.0;
  for (int trial = 0; trial < trials && !is_over(end_); ++trial) {
    high = guess(v, brake, high, dt) * (1.0 - least_part * trial);
    if (high == 0.0) break;
    blend(v, brake, high, dt);
    if (worst(0.0)) return {high, false};
  }
  path_.set_out(brake, dt, rows_.now().qpos);
  // What the step before has left may be used up by rounding.
  if (!is_over(end_)) {
    const bool kept = worst(-tolerance_);
    if (kept || !is_over(end_)) return {0.0, !kept};
  }
  const bool moves = std::any_of(brake, brake + n_, [](double rate) { return rate != 0.0; });
  if (still_ && !moves) return {0.0, false};
  // The brake may move on, as where joints come back into their ranges: one look says where to.
  look(1.0, all_.data(), count_, begin_);
  return {0.0, begin_.least < -tolerance_};
}

// Return a share below `high` at which the worst entry of the last look has room again.
double Shortening::guess(const double* v, const double* brake, double high, double dt) {
  double low = 0.0, room_low = infinity;
  double room_high = found_.least, share = 0.0;
  for (int k = 0; k < guesses; ++k) {
    blend(v, brake, share, dt);
    path_.way(found_.place, command_.data());
    put(command_.data());
    const double room = found_.entry.barrier->distance(own_, found_.entry.id) - found_.entry.floor;
    if (room < 0.0) {
      high = share;
      room_high = room;
    } else {
      low = share;
      room_low = room;
    }
    if (high == 0.0 || high - low < close || (room_low <= tolerance_ && low != 0.0)) break;
    const double part = nearer * room_low / (room_low - room_high);
    share = low + (high - low) * std::min(std::max(part, least_part), 1.0 - least_part);
  }
  return low;
}

// Set out with a share of v from the brake on.
void Shortening::blend(const double* v, const double* brake, double share, double dt) {
  for (int i = 0; i < n_; ++i) command_[i] = brake[i] + share * (v[i] - brake[i]);
  path_.set_out(command_.data(), dt, rows_.now().qpos);
}

double Shortening::go_to_end(const double* v, double dt) {
  path_.set_out(v, dt, rows_.now().qpos);
  path_.way(1.0, command_.data());
  put(command_.data());
  return dt;
}

double Shortening::go_to_rest(const double* v, double dt) {
  path_.set_out(v, dt, rows_.now().qpos);
  if (path_.last() == 1.0) return 0.0;
  path_.way(path_.last(), command_.data());
  put(command_.data());
  int most = 0;
  for (int i = 1; i < n_; ++i) {
    if (std::abs(v[i]) > std::abs(v[most])) most = i;
  }
  return command_[most] / v[most];
}

}  // namespace rmrc
