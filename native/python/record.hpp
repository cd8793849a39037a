// A step as Python has it: its numbers, of which arrays are made when they are asked for.
#pragma once

#include <nanobind/nanobind.h>

#include "control/stepper.hpp"

namespace rmrc {

/// Return the doubles of an array that is plainly `size` of them; null for anything else.
const double* plain(PyObject* object, Py_ssize_t size);

/// Return the last step of a stepper as a rmrc `Step` with these flags, a new reference, or null
/// with an error set; `owner` is its Python engine.
PyObject* make_step(const Stepper& stepper, const Summary& summary, PyObject* owner);

}  // namespace rmrc
