// The parts of the Python module.
#pragma once

#include <nanobind/nanobind.h>

namespace rmrc {

/// Add the engine and what it is built from.
void bind_engine(nanobind::module_& m);

}  // namespace rmrc
