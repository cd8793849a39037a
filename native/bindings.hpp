// The parts of the Python module.
#pragma once

#include <nanobind/nanobind.h>

namespace rmrc {

class Engine;
class Stepper;

/// Add the engine and what it is built from.
void bind_engine(nanobind::module_& m);

/// Add what takes a controller's steps.
void bind_stepper(nanobind::module_& m);

/// Add what takes the steps of many controllers at once.
void bind_batch(nanobind::module_& m);

/// Return the stepper of a Python `Stepper`, which lives as long as that.
Stepper& stepper_of(nanobind::handle object);

/// Return the engine of a Python `Engine`, which lives as long as that.
Engine& engine_of(nanobind::handle object);

}  // namespace rmrc
