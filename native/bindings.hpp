// The parts of the Python module, and the arrays that they take.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace rmrc {

using Reading = nanobind::ndarray<const double, nanobind::c_contig, nanobind::device::cpu>;
using Writing = nanobind::ndarray<double, nanobind::c_contig, nanobind::device::cpu>;
using Flags = nanobind::ndarray<std::uint8_t, nanobind::ndim<1>, nanobind::c_contig,
                                nanobind::device::cpu>;
using Numbers = std::vector<double>;

/// Refuse an array that has not this many elements.
template <class Array>
void require(const Array& array, std::size_t size, const char* what) {
  if (array.size() != size) throw std::invalid_argument(std::string(what) + " has a wrong size");
}

class Engine;
class ForwardKinematics;
class Rows;
class Shortening;
class Stepper;

/// Add the engine and what it is built from.
void bind_engine(nanobind::module_& m);

/// Add the forward kinematics.
void bind_kinematics(nanobind::module_& m);

/// Add the rows, and what checks a command where it leads.
void bind_rows(nanobind::module_& m);

/// Add what the hard tasks and the levels of an engine are handed over by.
void bind_levels(nanobind::module_& m);

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

/// Return the kinematics of a Python `ForwardKinematics`, which live as long as that.
ForwardKinematics& kinematics_of(nanobind::handle object);

/// Return the rows of a Python `Rows`, and the check of a Python `Shortening`.
Rows& rows_of(nanobind::handle object);
Shortening& shortening_of(nanobind::handle object);

}  // namespace rmrc
