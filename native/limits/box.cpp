#include "limits/box.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/numbers.hpp"

namespace rmrc {

namespace {

constexpr double range_rounding = 1e-9;  // rmrc.limits.box.RANGE_ROUNDING
constexpr double tiny = 1e-300;          // rmrc.limits.box.TINY
constexpr double far = 1e12;             // stands for the room of a joint without a range

// The largest speed from which a joint can stop in its room; any where it has none to stop in.
double stoppable(double room, double deceleration, double dt) {
  if (room < 0.0) return infinity;
  const double change = deceleration * dt, reach = 2.0 * deceleration * room;
  return reach / (std::sqrt(change * change + reach) + change);
}

// D(v, a) ≥ 0, the least way in which a joint stops: see rmrc.limits.jerk.
double stopping_way(double v, double a, double jerk, double most_deceleration) {
  const double gained = a * a / (2.0 * jerk);
  if (a < 0.0 && gained > v) {
    const double ahead = std::max(v, 0.0);
    return std::sqrt(ahead * ahead * ahead * (2.0 / 9.0) / jerk);
  }
  const double peak = std::max(v + gained, 0.0);
  const double strongest = std::min(std::sqrt(jerk * peak), most_deceleration);
  const double time = strongest > 0.0 ? peak / strongest : 0.0;
  const double way =
      0.5 * peak * (time + strongest / jerk) + a * (v + gained * (2.0 / 3.0)) / jerk;
  return std::max(way, 0.0);
}

// The largest velocity that a jerk limit allows, of a joint whose upper limit is `room` ahead.
double eased(double room, double v, double a, double jerk, double acceleration, double fastest,
             double gain, double dt) {
  const double change = jerk * dt;
  const double least = std::min(std::max(a - change, -acceleration), acceleration);
  const double below = std::max(fastest - v, 0.0);
  const double approach = std::sqrt(change * change + 2.0 * jerk * below) - change;
  const double most = std::max(std::min(std::min(a + change, approach), acceleration), least);
  const double rest = std::min(std::max(-v / dt, least), most);
  const double ahead = std::min(room, far);
  const auto margin = [&](double rate) {
    const double speed = v + rate * dt;
    return ahead - speed * (dt / gain) - stopping_way(speed, rate, jerk, acceleration);
  };
  // The margin is concave in the rate: where it changes sign, its chord crosses 0 on the safe side.
  const double middle = margin(rest);
  const bool stops = middle >= 0.0;
  const double inner = stops ? rest : least, outer = stops ? most : rest;
  const double kept = std::max(stops ? middle : margin(least), 0.0);
  const double missed = stops ? margin(most) : middle;
  const double share = missed < 0.0 ? kept / (kept - missed) : 1.0;
  return v + (inner + share * (outer - inner)) * dt;
}

}  // namespace

namespace {

// Return the steps that the joint takes to rest which takes longest at its a_max.
double longest(const JointLimits& limits, const double* v, double dt) {
  double steps = 0.0;
  for (std::size_t i = 0; i < limits.acceleration.size(); ++i) {
    steps = std::max(steps, std::abs(v[i]) / (limits.acceleration[i] * dt));
  }
  return std::max(steps, tiny);
}

// Return how far a joint may go on from q (nq,) with the sign of v.
double room_ahead(const JointLimits& limits, std::size_t i, double v, const double* q) {
  const double at = q[limits.coordinate[i]];
  return v > 0.0 ? limits.upper[i] - at : at - limits.lower[i];
}

// Return by how much |v| of a joint falls in each step where the slowest takes so many, once it has
// gone on for a time from q.
double slowed(const JointLimits& limits, std::size_t i, double v, double dt, const double* q,
              double ahead, double steps) {
  const double speed = std::abs(v), most = limits.acceleration[i] * dt;
  if (!std::isfinite(most)) return most;
  const double change = speed / steps;
  if (q == nullptr) return change;
  const double room = room_ahead(limits, i, v, q);
  const double way = 2.0 * (room - speed * ahead) + speed * dt;
  return std::max(change, way > 0.0 ? std::min(speed * speed * dt / way, most) : most);
}

}  // namespace

void braking(const JointLimits& limits, const double* v, double dt, const double* q, double* steps,
             double* change) {
  const double most = longest(limits, v, dt);
  for (std::size_t i = 0; i < limits.acceleration.size(); ++i) {
    change[i] = slowed(limits, i, v[i], dt, q, dt, most);
    steps[i] = v[i] == 0.0 ? 0.0 : std::abs(v[i]) / change[i];
  }
}

void braked(const JointLimits& limits, const double* v, double dt, const double* q, double* left) {
  const double most = longest(limits, v, dt);
  for (std::size_t i = 0; i < limits.acceleration.size(); ++i) {
    double change = slowed(limits, i, v[i], dt, q, 0.0, most);
    const double room = room_ahead(limits, i, v[i], q), a = limits.acceleration[i];
    if (room >= 0.0 && std::isfinite(room) && std::isfinite(a)) {
      change = std::max(change, std::min(std::abs(v[i]) - stoppable(room, a, dt), a * dt));
    }
    left[i] = v[i] - std::min(std::max(v[i], -change), change);
  }
}

Box::Box(JointLimits limits) : limits_(std::move(limits)) {}

bool Box::update(const double* q, const double* v_previous, const double* a_previous, double dt,
                 double* lb, double* ub) const {
  const JointLimits& is = limits_;
  const double rate = is.gain / dt;
  bool outside = false;
  for (std::size_t i = 0; i < is.lower.size(); ++i) {
    const double at = q[is.coordinate[i]], v = v_previous[i];
    const double below = is.lower[i] - at, above = is.upper[i] - at;
    outside |= below > range_rounding || above < -range_rounding;
    double low = below * rate, high = above * rate;
    const double a = is.acceleration[i], fastest = std::min(is.velocity[i], is.step[i] / dt);
    if (a < infinity) {
      const double back = is.lower[i] > -infinity ? stoppable(-below, a, dt) : infinity;
      const double ahead = is.upper[i] < infinity ? stoppable(above, a, dt) : infinity;
      low = std::min(std::max(low, -back), ahead);
      high = std::min(std::max(high, -back), ahead);
    }
    if (is.jerk[i] < infinity) {
      const double rate_before = a_previous[i], speed = is.velocity[i];
      double least =
          -eased(-below, -v, -rate_before, is.jerk[i], a, speed, is.gain, dt);
      double most = eased(above, v, rate_before, is.jerk[i], a, speed, is.gain, dt);
      if (least > most) least = most = 0.5 * (least + most);  // too little room on both sides
      const double floor = low, cap = high;
      low = std::min(std::max(least, floor), cap);
      high = std::min(std::max(most, floor), cap);
    }
    low = std::min(std::max(low, -fastest), fastest);
    high = std::min(std::max(high, -fastest), fastest);
    if (a < infinity) {
      const double change = a * dt;
      low = std::min(std::max(low, v - change), v + change);
      high = std::min(std::max(high, v - change), v + change);
    }
    lb[i] = low;
    ub[i] = high;
  }
  return outside;
}

}  // namespace rmrc
