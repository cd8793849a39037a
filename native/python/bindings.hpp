// The parts of the Python module, and the arrays that they take.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <limits>
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

/// Refuse `size` things from `first` on that are not all among `count`.
inline void require_part(std::int64_t first, std::int64_t size, std::int64_t count,
                         const char* what) {
  if (first < 0 || size < 0 || size > count || first > count - size) {
    throw std::invalid_argument(std::string("there is no such ") + what);
  }
}

/// Refuse an index that is none of `count`.
inline void require_index(std::int64_t index, std::int64_t count, const char* what) {
  require_part(index, 1, count, what);
}

/// Refuse dofs that are not among `nv`, or not in ascending order.
inline void require_dofs(const std::vector<int>& dofs, int nv) {
  int last = -1;
  for (const int dof : dofs) {
    require_index(dof, nv, "dof");
    if (dof <= last) throw std::invalid_argument("the dofs are not in ascending order");
    last = dof;
  }
}

/// Refuse a matrix whose elements an int cannot number.
inline void require_countable(std::int64_t rows, std::int64_t columns) {
  constexpr std::int64_t most = std::numeric_limits<int>::max();
  if (rows < 0 || columns < 0 || rows > most || columns > most || rows * columns > most) {
    throw std::invalid_argument("a size is out of range");
  }
}

/// Return a dict of one's own with what a dict holds.
inline nanobind::dict copied(const nanobind::dict& dict) {
  return nanobind::steal<nanobind::dict>(PyDict_Copy(dict.ptr()));
}

/// Return where the struct behind an object of the mujoco package stands.
///
/// Raises ValueError if it is none of that type.
void* address_of(nanobind::handle object, const char* type);

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

/// Refuse an engine whose levels have room for the rows and equalities that it has, and no more.
void require_no_levels(const Engine& engine);

/// Return what has to live as long as pointers that were taken from it.
const std::vector<nanobind::object>& kept_by(nanobind::handle engine);

/// Return the kinematics of a Python `ForwardKinematics`, which live as long as that.
ForwardKinematics& kinematics_of(nanobind::handle object);

/// Return the rows of a Python `Rows`, to which nothing can be added then, and the check of a
/// Python `Shortening`.
Rows& rows_of(nanobind::handle object);
Shortening& shortening_of(nanobind::handle object);

}  // namespace rmrc
