// Numbers that stand for nothing of rmrc's own.
#pragma once

#include <limits>

namespace rmrc {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double epsilon = std::numeric_limits<double>::epsilon();

}  // namespace rmrc
