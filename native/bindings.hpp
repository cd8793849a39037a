// The parts of the Python module.
#pragma once

#include <nanobind/nanobind.h>

namespace rmrc {

class Engine;
class Rows;
class Shortening;
class Stepper;

/// Add the engine and what it is built from.
void bind_engine(nanobind::module_& m);

/// Add the rows, and what checks a command where it leads.
void bind_rows(nanobind::module_& m);

/// Add what takes a controller's steps.
void bind_stepper(nanobind::module_& m);

/// Add the steps that a controller returns, and its two calls in a loop.
void bind_record(nanobind::module_& m);
void bind_loop(nanobind::module_& m);

/// Add what takes the steps of many controllers at once.
void bind_batch(nanobind::module_& m);

/// Return the stepper of a Python `Stepper`, which lives as long as that.
Stepper& stepper_of(nanobind::handle object);

/// Return the engine of a Python `Engine`, which lives as long as that.
Engine& engine_of(nanobind::handle object);

/// Return the rows of a Python `Rows`, and the check of a Python `Shortening`.
Rows& rows_of(nanobind::handle object);
Shortening& shortening_of(nanobind::handle object);

}  // namespace rmrc
