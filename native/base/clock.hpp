// The clock that deadlines are read off.
#pragma once

#include <algorithm>
#include <chrono>

namespace rmrc {

using Clock = std::chrono::steady_clock;

/// Return when so many seconds from now are over; the end of all time if they are infinite.
inline Clock::time_point end_after(double seconds) {
  constexpr double longest = 1e6;  // s: what may take longer has no end
  if (!(seconds < longest)) return Clock::time_point::max();
  const std::chrono::duration<double> left(std::max(seconds, 0.0));
  return Clock::now() + std::chrono::duration_cast<Clock::duration>(left);
}

/// Whether the clock says that it is over, which is not looked at where there is no end.
inline bool is_over(Clock::time_point end) {
  return end != Clock::time_point::max() && Clock::now() >= end;
}

}  // namespace rmrc
