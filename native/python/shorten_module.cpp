// The check of a command where it leads, in Python.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "engine/shorten.hpp"
#include "python/bound_rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

class BoundShortening {
 public:
  BoundShortening(nb::object rows, const BoundKinematics& own, Reading twist)
      : kept_{rows, own.data, own.kept, nb::cast(twist)},
        native_(checked(rows, own, twist), own.arrays, twist.data(),
                static_cast<int>(twist.size() / 6)) {}

  void follow(nb::object kinematics) {
    ForwardKinematics& native = kinematics_of(kinematics);
    if (native.coordinates() != native_.rows().mujoco().nq) {
      throw std::invalid_argument("the kinematics are another model's");
    }
    native_.follow(native);
    kept_.push_back(std::move(kinematics));
  }

  Shortening& operator*() { return native_; }

 private:
  static Rows& checked(nb::handle rows, const BoundKinematics& own, const Reading& twist) {
    Rows& native = rows_of(rows);
    if (own.counts != nb::cast<BoundRows&>(rows).counts()) {
      throw std::invalid_argument("the kinematics are another model's");
    }
    require(twist, 6 * own.counts.mocaps, "twist");
    return native;
  }

  std::vector<nb::object> kept_;
  Shortening native_;
};

}  // namespace

Shortening& shortening_of(nb::handle object) { return *nb::cast<BoundShortening&>(object); }

void bind_shortening(nb::module_& m) {
  nb::class_<BoundShortening>(m, "Shortening", "How much of a command may be carried out.")
      .def(nb::init<nb::object, const BoundKinematics&, Reading>(), nb::kw_only(), "rows"_a, "own"_a,
           "twist"_a.noconvert())
      .def("follow", &BoundShortening::follow, "kinematics"_a,
           "Place what the barriers look at by these, in place of MuJoCo's.")
      .def(
          "share",
          [](BoundShortening& bound, const Reading& v, const Reading& brake,
             double dt, double seconds) {
            const std::size_t n = (*bound).rows().dofs().size();
            require(v, n, "v");
            require(brake, n, "brake");
            const Share found = (*bound).share(v.data(), brake.data(), dt, end_after(seconds));
            return std::tuple(found.share, found.passed);
          },
          "v"_a, "brake"_a, "dt"_a, "seconds"_a,
          "Return how much of v keeps all distances, from the brake on, and whether one falls\n"
          "below its limit even so; nothing of it after so many seconds.");
}

}  // namespace rmrc
