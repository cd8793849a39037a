// The bits of a step's flags: bit k for the status of value k.
#pragma once

namespace rmrc::status {

constexpr unsigned limited = 1u << 1;         // rmrc.control.status.Status.LIMITED
constexpr unsigned scaled = 1u << 2;          // rmrc.control.status.Status.SCALED
constexpr unsigned damped = 1u << 3;          // rmrc.control.status.Status.DAMPED
constexpr unsigned recovering = 1u << 4;      // rmrc.control.status.Status.RECOVERING
constexpr unsigned relaxed = 1u << 5;         // rmrc.control.status.Status.RELAXED
constexpr unsigned stuck = 1u << 6;           // rmrc.control.status.Status.STUCK
constexpr unsigned max_iter = 1u << 7;        // rmrc.control.status.Status.MAX_ITER
constexpr unsigned deadline = 1u << 8;        // rmrc.control.status.Status.DEADLINE
constexpr unsigned stale = 1u << 9;           // rmrc.control.status.Status.STALE
constexpr unsigned invalid_input = 1u << 10;  // rmrc.control.status.Status.INVALID_INPUT

}  // namespace rmrc::status
