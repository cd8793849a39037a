// How a program, or a step, ended.
#pragma once

namespace rmrc {

/// How a solve ended: rmrc.qp.program.SolveStatus.
enum class SolveStatus { solved, max_iter, time_limit, infeasible, failed };

/// Return the value of that SolveStatus.
inline const char* name_of(SolveStatus status) {
  switch (status) {
    case SolveStatus::solved:
      return "solved";
    case SolveStatus::max_iter:
      return "max_iter";
    case SolveStatus::time_limit:
      return "time_limit";
    case SolveStatus::infeasible:
      return "infeasible";
    case SolveStatus::failed:
      return "failed";
  }
  return "";
}

}  // namespace rmrc
